"""Islands: populations that evolve apart and send their best to the next one now and then.

A search grows by islands once one population no longer fits into a machine's memory: each is
evaluated, selected and bred by itself, with random numbers of its own, and only a few individuals
pass between them. Every `EvolutionSettings.migration` generations the best tenth of each replaces
the worst of the next, the last one's those of the first. Fernández, Tomassini and Vanneschi
recommend a tenth every five to ten generations ("An empirical study of multipopulation genetic
programming", Genetic Programming and Evolvable Machines 4, 2003).
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.evolution import initial_state, next_state
from cgtorch.evolution.population import Population
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.evolution.state import EvolutionState
from cgtorch.graphs import Graphs, widened

MIGRANTS = 10  # one individual in so many


@dataclass(frozen=True)
class Island:
    """A population with random numbers of its own.

    Attributes:
        state: where its evolution stands.
        generator: of all its random choices.
    """

    state: EvolutionState
    generator: Generator


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Tried(Evaluated):
    """The same, and what each of them has solved, as in `Evaluation`."""

    succeeded: Tensor

    def best(self, count: int) -> "Tried":
        """The best of them."""
        rows = self.order[:count]
        return Tried.of([values.index_select(0, rows) for values in self.tensors()])

    def widened(self, nodes: int) -> "Tried":
        """The same with so many slots, as those have that others are to take over."""
        population = self.population
        graphs = widened(population.graphs, nodes)
        return replace(self, population=Population(graphs, population.strategy))

    def tensors(self) -> list[Tensor]:
        """All of it as tensors of P rows."""
        graphs, strategy = vars(self.population.graphs).values(), self.population.strategy
        return [*graphs, strategy, self.fitness, self.scores, self.succeeded]

    @staticmethod
    def of(tensors: Sequence[Tensor]) -> "Tried":
        """What `tensors` gave."""
        *graphs, strategy, fitness, scores, succeeded = tensors
        return Tried(Population(Graphs(*graphs), strategy), fitness, scores, succeeded)


def derived_generator(generator: Generator, number: int) -> Generator:
    """The random numbers of an island: the first one's are those given, others derive from them.

    Nothing is drawn for it, so with one island all is as it would be without islands.
    """
    if number == 0:
        return generator
    state = generator.get_state().numpy().tobytes()
    digest = hashlib.sha256(state + number.to_bytes(8, "big")).digest()
    return Generator().manual_seed(int.from_bytes(digest[:7], "big"))


def first_islands(
    numbers: Iterable[int],
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
    seeds: Population | None = None,
) -> list[Island]:
    """Those of the islands, counted from 0, whose numbers are given; see `initial_state`."""
    own = [derived_generator(generator, number) for number in numbers]
    return [Island(initial_state(settings, actions, each, seeds), each) for each in own]


def emigrants(tried: Tried, capacity: int) -> Tried:
    """Those that an island sends to the next one: its best, one at least, with so many slots."""
    return tried.best(max(1, len(tried.population) // MIGRANTS)).widened(capacity)


def migrated(tried: Tried, arrivals: Tried) -> Tried:
    """An island's individuals with `arrivals` in place of the worst of them."""
    stay = tried.order[: len(tried.order) - len(arrivals.population)].sort().values
    tried = tried.widened(arrivals.population.graphs.capacity)
    pairs = zip(tried.tensors(), arrivals.tensors(), strict=True)
    return Tried.of([torch.cat([old[stay], new]) for old, new in pairs])


def next_islands(
    islands: Sequence[Island],
    tried: Sequence[Tried],
    settings: EvolutionSettings,
    actions: ActionSet,
) -> list[Island]:
    """Each island's next generation, given how this one did; see `tell`."""
    made = []
    for island, each in zip(islands, tried, strict=True):
        state = next_state(island.state, each, settings, actions, island.generator)
        made.append(replace(island, state=state))
    return made
