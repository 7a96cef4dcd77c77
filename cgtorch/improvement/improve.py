"""Algorithm 1: a new skill that forgets nothing and solves something new.

Growing one graph under a hard W stalls, so the default is to divide, evolve and compose: local
groups of missed scenarios get specialists of their own, and branching nodes, trained by gradient,
send each scenario to a member that solves it. `cgtorch.improvement.grow` is the paper's own way.

Of a large W, members are tried on a coreset only. Whether eq. 1a holds is checked on all of W.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.improvement.attempt import attempt
from cgtorch.improvement.coreset import cover
from cgtorch.improvement.events import SkillAccepted, Watch
from cgtorch.improvement.interfaces import S
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
from cgtorch.improvement.trial import first_percepts

Draw: TypeAlias = Callable[[Generator], S]
"""Draws fresh scenarios of the kind a stage is about."""

CHECKS = 8  # on all of W, before a team is given up


def improve(
    setup: Setup[S],
    progress: Progress[S],
    stage: str,
    scenarios: S,
    targets: Tensor,
    draw: Draw[S],
    generator: Generator,
    watch: Watch,
) -> Progress[S]:
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
    start, rest = _without_rest(setup, progress)
    task = make_task(setup, start, stage, scenarios, targets)
    team = first_team(setup, progress, task)
    tried, result = 0, None
    for _ in range(setup.rounds):
        team, tried = _recruit_all(setup, team, task, tried, generator, watch)
        work, composed = _compose(setup, (task, team, rest), progress, generator, watch)
        if composed is None and tried < setup.attempts and not task.keep.all():
            tried += 1
            work = _with_one_more(setup, work, tried, generator, watch)
            work, composed = _compose(setup, work, progress, generator, watch)
        task, team, rest = work
        if composed is None:
            break
        skill, succeeded = composed
        watch(_accepted(task, rest, skill, succeeded, time.perf_counter() - began))
        fresh = draw(generator)
        solved = torch.cat([succeeded, attempt(setup, skill, fresh).succeeded])
        task, team = with_fresh(setup, task, team, solved, fresh)
        # A further try that fails has moved parts of the rest into its task.
        result = skill, task.scenarios, solved, rest
        if solved.all() or not len(fresh):
            break
    progress = replace(progress, knowledge=team.knowledge, specialists=team.population)
    if result is None:
        return progress
    skill, everything, solved, rest = result
    return replace(
        progress,
        skill=skill,
        solved=everything[solved.nonzero()[:, 0]].joined(rest),
        missed=everything[(~solved).nonzero()[:, 0]],
    )


Work: TypeAlias = tuple[Task[S], Team, S]
"""A task with its team, and what of W is in neither."""


def _without_rest(setup: Setup[S], progress: Progress[S]) -> tuple[Progress[S], S]:
    """The progress with a coreset of W only, and the rest of W."""
    rows, _ = cover(first_percepts(setup.world_of(progress.solved)), setup.core)
    kept = torch.zeros(len(progress.solved), dtype=torch.bool)
    kept[rows] = True
    rest = progress.solved[(~kept).nonzero()[:, 0]]
    return replace(progress, solved=progress.solved[rows]), rest


def _compose(
    setup: Setup[S], work: Work[S], progress: Progress[S], generator: Generator, watch: Watch
) -> tuple[Work[S], tuple[Skill, Tensor] | None]:
    """What `compose_team` gives, once it loses nothing of the rest of W either; None if it does.

    What was lost of the rest joins the task, and another team is composed.
    """
    task, team, rest = work
    for _ in range(CHECKS):
        composed = compose_team(setup, team, task, progress, generator, watch)
        if composed is None or not len(rest):
            return (task, team, rest), composed
        held = attempt(setup, composed[0], rest).succeeded
        if held.all():
            return (task, team, rest), composed
        keep = torch.cat([task.keep, torch.ones(int((~held).sum()), dtype=torch.bool)])
        task, team = with_fresh(setup, task, team, keep, rest[(~held).nonzero()[:, 0]])
        rest = rest[held.nonzero()[:, 0]]
    return (task, team, rest), None


def _with_one_more(
    setup: Setup[S], work: Work[S], number: int, generator: Generator, watch: Watch
) -> Work[S]:
    """The work with a specialist for all that the earlier skill misses, whoever else solves it.

    Where no branches could tell the members apart, it makes that easier.
    """
    task, team, rest = work
    name = f"{task.stage}.{number}"
    return task, recruit(setup, team, task, name, ~task.keep, generator, watch), rest


def _accepted(
    task: Task[S], rest: S, skill: Skill, succeeded: Tensor, seconds: float
) -> SkillAccepted[S]:
    """The event of a new skill, which succeeds on all of the rest, too."""
    yes = torch.ones(len(rest), dtype=torch.bool)
    return SkillAccepted(
        task.stage,
        skill,
        task.scenarios.joined(rest),
        torch.cat([succeeded, yes]),
        torch.cat([task.keep, yes]),
        torch.cat([task.targets, ~yes]),
        seconds,
    )


def _recruit_all(
    setup: Setup[S], team: Team, task: Task[S], tried: int, generator: Generator, watch: Watch
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
