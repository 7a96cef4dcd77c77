"""Algorithm 2 as a stream of generations."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet, check_action
from cgtorch.environment import Environment
from cgtorch.environment.dry_run import check_environment
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
from cgtorch.graphs import SubSkill
from cgtorch.ground import distributed as ranks
from cgtorch.native.gpu import launcher_of
from cgtorch.simulation import MAX_TRANSITIONS


@dataclass(frozen=True)
class Generation:
    """One evaluated generation of all islands.

    Attributes:
        number: counted from 0.
        islands: those that this rank holds, with the individuals that were evaluated.
        fitness: (P,) of the first of these.
        champion: the best individual of all islands, as a population of one; of equal ones the
            smallest, of these that of the first island.
        best: its fitness.
        succeeded: (B,) bool, what it solves in the models.
        transitions: actions of all until the ends of their runs, also those of endless loops.
        executed: how many of them were executed, and not only counted.
        not_finite: individuals that count for nothing, as something about them was not finite.
        distinct_parents: how many individuals the first of the islands descends from directly; 0 of
            a first population, and of samples of lineages.
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
"""Makes the environment of each generation, counted from 0; all have as many scenarios."""


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
    """Evolve without end; whoever iterates decides when it is enough.

    All ranks (`cgtorch.ground.distributed`) share the islands. Each is told the same, but for the
    islands that it holds itself.

    Where scenarios are many, such as random starts of episodes, each generation can have others: a
    function that makes `Environments` is given in place of one environment.

    Of the environment's scenarios `keep` (B,) bool, on its device, are those of W (eq. 1a); none,
    on the CPU, if not given. Half of each first population are `seeds`, earlier individuals, if
    given. If `islands` are given, those that this rank holds, they go on in place of first
    populations. The generator, of all random choices, goes on only where the first island is held.

    Raises:
        WorldError: the environment, tried on two scenarios, breaks its interface.
        ActionError: an action does.
        SettingsError: a selection, crossover, mutation or fitness of the settings does.
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
    """Where populations are bred: on a GPU if the library's own operators run there, else a CPU.

    Of several ranks each has its own on the CPU, from where they are shared.
    """
    own = settings.crossover is not crossover or settings.mutation is not mutate
    if own or settings.lineages or ranks.count() > 1 or launcher_of(device) is None:
        return torch.device("cpu")
    few = compiled.within_limits(settings.capacity, actions.outcome_capacity)
    return device if few else torch.device("cpu")


def placed(island: Island, device: torch.device) -> Island:
    """An island whose population is on a device."""
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
    """Individuals of other islands, given equally many of each that this rank holds."""
    columns = zip(*(each.tensors() for each in mine), strict=True)
    found = [share(torch.stack(column), count) for column in columns]
    return [Tried.of(values) for values in zip(*found, strict=True)]
