"""Specialists: small graphs evolved on a local group of missed scenarios, without W to carry."""

import time
from collections.abc import Callable
from math import inf
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment
from cgtorch.evolution import EvolutionSettings, Generation, Population, evolve
from cgtorch.graphs import widened
from cgtorch.ground import distributed as ranks
from cgtorch.improvement.events import EvolutionRecalled, GenerationDone, Watch
from cgtorch.improvement.journal import Journal, NoJournal
from cgtorch.improvement.stopping import (
    Budget,
    Found,
    found_from,
    found_tensors,
    islands_from,
    restore,
    standing_of,
)


def evolve_candidate(
    environment: Environment,
    actions: ActionSet,
    settings: EvolutionSettings,
    budget: Budget,
    generator: Generator,
    watch: Watch,
    stage: str,
    name: str,
    *,
    keep: Tensor | None = None,
    seeds: Population | None = None,
    max_transitions: int = 20,
    device: torch.device | str = "cpu",
    journal: Journal | None = None,
) -> tuple[Population, Tensor]:
    """Evolve until all scenarios are solved in the models and the fitness has settled.

    The environment runs on `device`; see `cgtorch.evolution.evolve` for the other arguments. What
    the `journal` knows is not evolved again.

    Returns:
        The best individual, as a population of one with `settings.capacity` slots, and (B,) bool
        what it solves in the models.
    """
    journal, step = journal or NoJournal(), f"evolution {name}"
    keep = torch.zeros(environment.num_scenarios, dtype=torch.bool) if keep is None else keep
    found, islands = None, None
    if known := journal.recall(step):
        found = found_from(known, actions, len(keep))
        watch(_recalled(stage, name, found))
        restore(generator, known)
        return _roomy(found.champion, settings.capacity), found.solved
    if standing := journal.recall_standing(step):
        found = found_from(standing.about, actions, len(keep))
        islands = islands_from(standing, actions, generator, settings.islands)
        watch(_recalled(stage, name, found))
    began = time.perf_counter()
    for generation in evolve(
        environment,
        actions,
        settings,
        generator,
        keep=keep.to(device),
        seeds=seeds,
        islands=islands,
        max_transitions=max_transitions,
    ):
        found = found or Found(generation.champion, keep, -inf)
        stands = standing_of(found, generation.islands, settings.islands)
        journal.record_standing(step, stands)
        now = time.perf_counter()
        watch(_done(stage, name, generation, budget, keep, now - began))
        found, began = found.after(generation, now - began), now
        if found.ends(budget):
            break
    assert found is not None  # noqa: S101  the loop body has run
    # Where the first island is not held, its random numbers have not been drawn.
    generator.set_state(ranks.told(generator.get_state()))
    journal.record(step, {**found_tensors(found), "generator": generator.get_state()})
    return _roomy(found.champion, settings.capacity), found.solved


def _roomy(individual: Population, capacity: int) -> Population:
    return Population(widened(individual.graphs, capacity), individual.strategy)


def _recalled(stage: str, name: str, found: Found) -> EvolutionRecalled:
    counts = found.generations, found.transitions, found.seconds
    return EvolutionRecalled(stage, name, *counts, found.champion, found.best)


def _done(
    stage: str, name: str, generation: Generation, budget: Budget, keep: Tensor, seconds: float
) -> GenerationDone:
    solved = generation.succeeded
    return GenerationDone(
        stage,
        name,
        generation,
        budget.generations,
        solved_w=int(solved[keep].sum()),
        size_w=int(keep.sum()),
        solved_m=int(solved[~keep].sum()),
        size_m=int((~keep).sum()),
        seconds=seconds,
    )


Grouping: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""First percepts (B, D), (B,) bool what is missed, a size, and a generator to the indices (n,) of
a group of missed scenarios that a specialist is evolved on."""


def broad_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of missed scenarios, drawn at random; the arguments are those of `local_group`."""
    rows = missed.nonzero()[:, 0]
    return rows[torch.randperm(len(rows), generator=generator)[:size]]


def local_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of a random missed scenario and the missed ones nearest to it.

    Args:
        percepts: (B, D) first percepts.
        missed: (B,) bool.
        size: the most scenarios in a group.
        generator: of the choice.
    """
    rows = missed.nonzero()[:, 0]
    seed = rows[torch.randint(len(rows), (1,), generator=generator)]
    distance = torch.cdist(percepts[rows], percepts[seed])[:, 0]
    return rows[distance.argsort(stable=True)[:size]]
