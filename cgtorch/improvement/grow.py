"""The paper's method: grow one graph with W as a hard constraint (Algorithms 1 and 2, eq. 3)."""

import time
from dataclasses import replace

import torch

from cgtorch.evolution import Population, initial_strategy
from cgtorch.graphs import Skill
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.improvement.events import S, SkillAccepted, WorldTested, solved_of
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.improvement.team import learned
from cgtorch.improvement.trial import attempt, looked


def grow(setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]) -> Progress[S]:
    """Evolve the graph of the last skill until it keeps W and solves all of M.

    Half of each first population are copies of the last graph. The fitness is 0 if a scenario of W
    fails. A graph that meets eq. 1 in the world is where the next attempt starts. Arguments and
    result are those of `cgtorch.improvement.improve.improve`; fresh scenarios are drawn only where
    there is nothing else to solve.
    """
    began = time.perf_counter()
    if not len(tests) + len(progress.missed):  # as in a first round
        tests = draw(setup.group, setup.generator)
    scenarios = progress.solved.joined(tests, progress.missed)
    keep = torch.arange(len(scenarios)) < len(progress.solved)
    knowledge, skill, targets = progress.knowledge, progress.skill, ~keep
    solved = torch.zeros_like(keep)
    try:
        percepts = looked(setup, scenarios)
        if skill is not None:
            solved = attempt(setup, skill, scenarios, "trials").succeeded
    except BudgetSpentError:
        return progress
    first = keep
    accepted = None
    for number in range(setup.attempts):
        environment = setup.imagine(
            knowledge, scenarios, percepts, 1, setup.generator, setup.device
        )
        # The last skill's graph is a population of one.
        seeds = Population(skill.graph, initial_strategy(1)) if skill else None
        name = f"{setup.name}.{number + 1}"
        champion = evolve_candidate(setup, name, environment, keep=keep, seeds=seeds).champion
        candidate = Skill(setup.name, champion.graphs, setup.actions, setup.max_transitions)
        try:
            trial = attempt(setup, candidate, scenarios, "trials")
        except BudgetSpentError:
            break
        counts = solved_of(trial.succeeded, first)
        setup.watch(WorldTested(setup.name, candidate.name, *counts))
        if trial.succeeded[keep].all() and (trial.succeeded & ~solved).any():
            skill = accepted = candidate
            keep = solved = trial.succeeded
        if solved.all():
            break
        knowledge = learned(setup, knowledge, trial.experience)
    if accepted is None:
        return replace(progress, knowledge=knowledge)
    result = scenarios, solved, first, targets
    parent = None if progress.skill is None else progress.skill.name
    seconds = time.perf_counter() - began
    setup.watch(SkillAccepted(setup.name, accepted, *result, seconds, parent=parent))
    seen = torch.cat([percepts[solved], percepts[~solved]])
    progress = replace(progress, solved=scenarios[solved], missed=scenarios[~solved], seen=seen)
    return replace(progress, skill=accepted, knowledge=knowledge)
