"""Algorithm 2 as an endless stream of generations."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled
from cgtorch.evolution.fitness import Evaluation, evaluator
from cgtorch.evolution.islands import (
    Island,
    Tried,
    emigrants,
    first_islands,
    migrated,
    next_islands,
)
from cgtorch.evolution.offspring import crossover, mutate
from cgtorch.evolution.operator_checks import check_parts
from cgtorch.evolution.population import Population
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.graphs import ActionSet, SubSkill, check_action
from cgtorch.ground import distributed as ranks
from cgtorch.ground.dry_run import check_environment
from cgtorch.ground.environment import Environment
from cgtorch.native.gpu import launcher_of
from cgtorch.simulation import MAX_TRANSITIONS


@dataclass(frozen=True)
class Generation:
    """One evaluated generation of all islands.

    Attributes:
        number: Counted from 0.
        islands: The islands that this rank holds, with the individuals that were evaluated.
        fitness: (P,) of the first of these islands.
        champion: The best individual of all islands, a population of one. Of equally fit ones, the
            smallest; of these, the one of the first island.
        best: The fitness of the champion.
        succeeded: (B,) bool, the scenarios that the champion solves in the environment.
        transitions: Number of actions until the ends of all rollouts, those of endless loops
            included.
        executed: How many of these were actually executed; the rest of a loop is only counted.
        not_finite: Number of individuals that do not count, because some of their numbers are not
            finite.
        distinct_parents: Number of different parents of the first island; 0 for a first population
            and for samples of lineages.
    """

    number: int
    islands: Sequence[Island]
    fitness: Tensor
    champion: Population
    best: float
    succeeded: Tensor
    transitions: int
    executed: int
    not_finite: int = 0
    distinct_parents: int = 0

    @property
    def population(self) -> Population:
        """The individuals of the first island that this rank holds."""
        return self.islands[0].state.population


Environments: TypeAlias = Callable[[int], Environment]
"""Makes the environment of each generation, counted from 0. All have equally many scenarios."""


def evolve(
    environment: Environment | Environments,
    actions: ActionSet,
    settings: EvolutionSettings,
    generator: Generator,
    *,
    keep: Tensor | None = None,
    seeds: Population | None = None,
    islands: Sequence[Island] | None = None,
    max_transitions: int = MAX_TRANSITIONS,
) -> Iterator[Generation]:
    """Evolve without end: the caller decides when to stop iterating.

    Args:
        environment: The scenarios, or a function that makes those of each generation
            (`Environments`), for example random starts of episodes.
        actions: What nodes can do.
        settings: How populations evolve.
        generator: The generator of all random choices. It advances only on the rank that holds the
            first island.
        keep: (B,) bool, the scenarios of W (eq. 1a), on the environment's device. By default none,
            on the CPU.
        seeds: Earlier individuals, which become half of each first population.
        islands: Islands of this rank to continue, in place of first populations.
        max_transitions: Transitions after which a rollout fails.

    The ranks (`cgtorch.ground.distributed`) share the islands. All ranks must pass the same
    arguments, except for `islands`.

    Raises:
        WorldError: In a dry run on two scenarios, the environment breaks its interface.
        ActionError: An action breaks its interface.
        SettingsError: A selection, crossover, mutation or fitness of the settings breaks its
            interface.
    """
    begin = islands[0].state.generation if islands else 0
    first = environment(begin) if callable(environment) else environment
    if keep is None:
        keep = torch.zeros(first.num_scenarios, dtype=torch.bool)
    check_environment(first, keep.device)
    for name, action in zip(actions.names, actions.actions, strict=True):
        if not isinstance(action, SubSkill):
            check_action(name, action, first, keep.device)
    check_parts(settings, actions, first, keep.device)
    count, group = settings.islands, ranks.group_of(settings.islands)
    if islands is None:
        islands = first_islands(ranks.held(count), settings, actions, generator, seeds)
    home = home_of(settings, actions, keep.device)
    islands = [placed(island, home) for island in islands]
    about = partial(
        evaluator, actions, keep=keep, max_transitions=max_transitions, group=group,
        fitness=settings.fitness,
    )  # fmt: skip
    evaluation = about(environment=first)
    while True:
        results = [evaluation(island.state.population.graphs) for island in islands]
        tried = [
            Tried(island.state.population, result.fitness, result.scores, result.succeeded)
            for island, result in zip(islands, results, strict=True)
        ]
        generation = _generation(islands, tried, results, settings)
        yield generation
        if count > 1 and (generation.number + 1) % settings.migration == 0:
            leaving = [emigrants(each, settings.capacity) for each in tried]
            arrivals = _shared(ranks.ring_shift, leaving, count)
            tried = [migrated(*pair) for pair in zip(tried, arrivals, strict=True)]
        islands = next_islands(islands, tried, settings, actions)
        if callable(environment):
            evaluation = about(environment=environment(generation.number + 1))


def home_of(settings: EvolutionSettings, actions: ActionSet, device: torch.device) -> torch.device:
    """The device where populations are bred: the GPU if all operators run there, else the CPU.

    With several ranks, each breeds on the CPU.
    """
    own = settings.crossover is not crossover or settings.mutation is not mutate
    if own or settings.lineages or ranks.count() > 1 or launcher_of(device) is None:
        return torch.device("cpu")
    few = compiled.within_limits(settings.capacity, actions.outcome_capacity)
    return device if few else torch.device("cpu")


def placed(island: Island, device: torch.device) -> Island:
    """The island with its population on a device."""
    if island.state.population.strategy.device == device:
        return island
    state = replace(island.state, population=island.state.population.to(device))
    return replace(island, state=state)


def _generation(
    islands: Sequence[Island],
    tried: Sequence[Tried],
    results: Sequence[Evaluation],
    settings: EvolutionSettings,
) -> Generation:
    """The generation of all islands, given those that this rank holds."""
    count, leaders = settings.islands, [each.best(1) for each in tried]
    if len(leaders) < count:
        leaders = _shared(
            ranks.all_gather_parts, [x.widened(settings.capacity) for x in leaders], count
        )
    best = min(leaders, key=lambda x: (-float(x.fitness), int(x.population.graphs.num_nodes)))
    transitions, executed, not_finite = (
        int(ranks.all_gather_parts(torch.tensor(numbers), count).sum())
        for numbers in zip(
            *((r.transitions, r.executed, r.not_finite) for r in results), strict=True
        )
    )
    return Generation(
        number=islands[0].state.generation,
        islands=islands,
        fitness=tried[0].fitness,
        champion=best.population.to("cpu"),
        best=float(best.fitness),
        succeeded=best.succeeded[0].cpu(),
        transitions=transitions,
        executed=executed,
        not_finite=not_finite,
        distinct_parents=islands[0].state.distinct_parents,
    )


def _shared(
    share: Callable[[Tensor, int], Tensor], mine: Sequence[Tried], count: int
) -> list[Tried]:
    """Individuals of other islands, given equally many of each island that this rank holds."""
    columns = zip(*(each.tensors() for each in mine), strict=True)
    found = [share(torch.stack(column), count) for column in columns]
    return [Tried.of(values) for values in zip(*found, strict=True)]
