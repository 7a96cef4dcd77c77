"""Islands: populations that evolve separately and exchange their best individuals now and then.

Islands let a search grow beyond the memory of one machine. Each island is evaluated and bred by
itself, with its own random numbers. Every `EvolutionSettings.migration` generations, the best tenth
of each island replaces the worst tenth of the next island; the last island sends to the first.
Fernández, Tomassini and Vanneschi recommend a tenth every five to ten generations ("An empirical
study of multipopulation genetic programming", Genetic Programming and Evolvable Machines 4, 2003).
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.evolution import initial_state, next_state
from cgtorch.evolution.population import Population
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.evolution.state import EvolutionState
from cgtorch.graphs import ActionSet, Graphs, widened

MIGRANTS = 10  # one individual in so many


@dataclass(frozen=True)
class Island:
    """A population with its own random numbers.

    Attributes:
        state: The state of its evolution.
        generator: The generator of all its random choices.
    """

    state: EvolutionState
    generator: Generator


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Tried(Evaluated):
    """`Evaluated` individuals, with `succeeded` (P, B) as in `Evaluation`."""

    succeeded: Tensor

    def best(self, count: int) -> "Tried":
        """The `count` best individuals."""
        rows = self.order[:count]
        return Tried.of([values.index_select(0, rows) for values in self.tensors()])

    def widened(self, nodes: int) -> "Tried":
        """The same individuals, with graphs of `nodes` slots."""
        population = self.population
        graphs = widened(population.graphs, nodes)
        return replace(self, population=Population(graphs, population.strategy))

    def tensors(self) -> list[Tensor]:
        """All fields as tensors with P rows each."""
        graphs, strategy = vars(self.population.graphs).values(), self.population.strategy
        return [*graphs, strategy, self.fitness, self.scores, self.succeeded]

    @staticmethod
    def of(tensors: Sequence[Tensor]) -> "Tried":
        """The inverse of `tensors`."""
        *graphs, strategy, fitness, scores, succeeded = tensors
        return Tried(Population(Graphs(*graphs), strategy), fitness, scores, succeeded)


def derived_generator(generator: Generator, number: int) -> Generator:
    """The generator of an island: the given one for island 0, else one derived from its state.

    Nothing is drawn from the given generator, so a single island gives the results of no islands.
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
    """The islands with these numbers, counted from 0; see `initial_state`."""
    own = [derived_generator(generator, number) for number in numbers]
    return [Island(initial_state(settings, actions, each, seeds), each) for each in own]


def emigrants(tried: Tried, capacity: int) -> Tried:
    """The best tenth of an island, at least one individual, with graphs of `capacity` slots."""
    return tried.best(max(1, len(tried.population) // MIGRANTS)).widened(capacity)


def migrated(tried: Tried, arrivals: Tried) -> Tried:
    """The individuals of an island, with the worst of them replaced by `arrivals`."""
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
    """The next generation of each island, given its evaluated individuals; see `tell`."""
    made = []
    for island, each in zip(islands, tried, strict=True):
        state = next_state(island.state, each, settings, actions, island.generator)
        made.append(replace(island, state=state))
    return made
