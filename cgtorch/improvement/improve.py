"""Algorithm 1: a new skill that forgets nothing and solves something new.

Growing one graph under a hard W stalls, so the default is to divide, evolve and compose: local
groups of missed scenarios get specialists of their own, and branching nodes, trained by gradient,
send each scenario to a member that solves it. `cgtorch.improvement.grow` is the paper's own way.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.improvement.events import SkillAccepted, Watch
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.team import (
    Task,
    Team,
    compose_team,
    first_team,
    make_task,
    recruit,
    with_fresh,
)
from cgtorch.improvement.trial import try_skill
from cgtorch.world import Scenarios

Draw: TypeAlias = Callable[[Generator], Scenarios]
"""Draws fresh scenarios of the kind a stage is about."""


def improve(
    setup: Setup,
    progress: Progress,
    stage: str,
    scenarios: Scenarios,
    targets: Tensor,
    draw: Draw,
    generator: Generator,
    watch: Watch,
) -> Progress:
    """Divide, evolve and compose, and again with what fails on fresh scenarios.

    Args:
        setup: what to work with.
        progress: where the earlier stages ended.
        stage: name of the new skill.
        scenarios: what the new skill shall solve.
        targets: their bool mask of the stage's own test placements.
        draw: gives fresh scenarios to test an accepted skill on.
        generator: of all random choices.
        watch: told what happens.

    Returns:
        The new skill with what it solves and misses; the old one where eq. 1 could not be met.
    """
    began = time.perf_counter()
    task = make_task(setup, progress, stage, scenarios, targets)
    team = first_team(setup, progress, task)
    tried, result = 0, None
    for _ in range(setup.rounds):
        team, tried = _recruit_all(setup, team, task, tried, generator, watch)
        composed = compose_team(setup, team, task, progress, generator, watch)
        if composed is None:
            break
        skill, succeeded = composed
        seconds = time.perf_counter() - began
        watch(
            SkillAccepted(stage, skill, task.scenarios, succeeded, task.keep, task.targets, seconds)
        )
        fresh = draw(generator)
        solved = torch.cat([succeeded, try_skill(skill, setup.world_of(fresh)).succeeded])
        task, team = with_fresh(setup, task, team, solved, fresh)
        result = skill, task.scenarios, solved
        if solved.all():
            break
    progress = replace(progress, knowledge=team.knowledge, specialists=team.population)
    if result is None:
        return progress
    skill, everything, solved = result
    return replace(
        progress,
        skill=skill,
        solved=everything[solved.nonzero()[:, 0]],
        missed=everything[(~solved).nonzero()[:, 0]],
    )


def _recruit_all(
    setup: Setup, team: Team, task: Task, tried: int, generator: Generator, watch: Watch
) -> tuple[Team, int]:
    """Recruit until every scenario has a member that always solves it, or it does not get better.

    `tried` counts the stage's evolutions; the new count is returned with the team.
    """
    idle = 0
    while tried < setup.attempts and idle < setup.idle:
        missed = (team.rates < 1).all(1)
        if not missed.any():
            break
        tried += 1
        size = len(team.members)
        team = recruit(setup, team, task, f"{task.stage}.{tried}", missed, generator, watch)
        idle = 0 if len(team.members) > size else idle + 1
    return team, tried
