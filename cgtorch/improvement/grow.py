"""The paper's own way: grow one graph under a hard W (Algorithms 1 and 2, eq. 3)."""

import time
from dataclasses import replace

import torch
from torch import Generator, Tensor

from cgtorch.evolution import Population, initial_strategy
from cgtorch.graphs import Skill
from cgtorch.improvement.attempt import attempt
from cgtorch.improvement.events import SkillAccepted, Watch
from cgtorch.improvement.improve import Draw
from cgtorch.improvement.interfaces import S
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.improvement.team import learned, make_task, world_tested


def grow(
    setup: Setup[S],
    progress: Progress[S],
    stage: str,
    scenarios: S,
    targets: Tensor,
    draw: Draw[S],
    generator: Generator,
    watch: Watch,
) -> Progress[S]:
    """Evolve the last skill's own graph until it keeps W and solves all of M.

    Half of each first population is the last graph; fitness is 0 where a scenario of W fails.
    What meets eq. 1 in the world becomes the graph that the next attempt starts from. Arguments
    and result are those of `cgtorch.improvement.improve.improve`; fresh scenarios are not drawn.
    """
    began = time.perf_counter()
    task = make_task(setup, progress, stage, scenarios, targets)
    knowledge, skill = progress.knowledge, progress.skill
    keep = task.keep
    solved = torch.zeros_like(keep)
    if skill is not None:
        solved = attempt(setup, skill, task.scenarios).succeeded
    accepted = None
    for number in range(setup.attempts):
        environment = setup.imagine(
            knowledge, task.scenarios, task.percepts, 1, generator, setup.device
        )
        champion, _ = evolve_candidate(
            environment,
            setup.actions,
            setup.evolution,
            setup.budget,
            generator,
            watch,
            stage,
            f"{stage}.{number + 1}",
            keep=keep,
            seeds=_seed(skill),
            max_transitions=setup.max_transitions,
            device=setup.device,
            journal=setup.journal,
        )
        candidate = Skill(stage, champion.graphs, setup.actions, setup.max_transitions)
        trial = attempt(setup, candidate, task.scenarios)
        watch(world_tested(task, candidate.name, trial.succeeded))
        if trial.succeeded[keep].all() and (trial.succeeded & ~solved).any():
            skill = accepted = candidate
            solved = trial.succeeded
            keep = solved
        if solved.all():
            break
        knowledge = learned(setup, knowledge, trial.experience, stage, generator, watch)
    if accepted is None:
        return replace(progress, knowledge=knowledge)
    seconds = time.perf_counter() - began
    watch(SkillAccepted(stage, accepted, task.scenarios, solved, task.keep, task.targets, seconds))
    return Progress(
        skill=accepted,
        solved=task.scenarios[solved.nonzero()[:, 0]],
        missed=task.scenarios[(~solved).nonzero()[:, 0]],
        knowledge=knowledge,
    )


def _seed(skill: Skill | None) -> Population | None:
    """The last skill's graph as a population of one."""
    return Population(skill.graph, initial_strategy(1)) if skill else None
