"""Specialists: small graphs evolved on a local group of missed scenarios, without W to carry."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment
from cgtorch.evolution import EvolutionSettings, Population, evolve
from cgtorch.improvement.events import GenerationDone, Watch


@dataclass(frozen=True)
class Budget:
    """When to stop searching.

    Attributes:
        generations: the most for one evolution.
        patience: generations without a better fitness, once all is solved in the models.
        stall: generations without a better fitness after which the search gives up.
        enough: fitness with which a candidate that solves all is good enough.
        transitions: actions executed in the models after which no generation is begun.
    """

    generations: int = 150
    patience: int = 10
    stall: int = 40
    enough: float = 0.97
    transitions: float = float("inf")


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
) -> tuple[Population, Tensor]:
    """Evolve until all scenarios are solved in the models and the fitness has settled.

    The environment runs on `device`; see `cgtorch.evolution.evolve` for the other arguments.

    Returns:
        The best individual, as a population of one, and (B,) bool what it solves in the models.
    """
    keep = torch.zeros(environment.num_scenarios, dtype=torch.bool) if keep is None else keep
    champion, solved, best, since, spent = None, keep, -1.0, 0, 0
    began = time.perf_counter()
    for generation in evolve(
        environment,
        actions,
        settings,
        generator,
        keep=keep.to(device),
        seeds=seeds,
        max_transitions=max_transitions,
    ):
        now = time.perf_counter()
        result = generation.succeeded
        watch(
            GenerationDone(
                stage,
                name,
                generation,
                budget.generations,
                solved_w=int(result[keep].sum()),
                size_w=int(keep.sum()),
                solved_m=int(result[~keep].sum()),
                size_m=int((~keep).sum()),
                seconds=now - began,
            )
        )
        began = now
        fitness = float(generation.fitness[generation.best])
        since += 1
        spent += generation.transitions
        if fitness > best + 1e-3:
            champion, solved, best, since = generation.champion, result, fitness, 0
        done = bool(solved.all()) and (best >= budget.enough or since >= budget.patience)
        last = generation.number + 1 >= budget.generations or spent >= budget.transitions
        if done or since >= budget.stall or last:
            break
    assert champion is not None  # noqa: S101  the loop body has run
    return champion, solved


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
