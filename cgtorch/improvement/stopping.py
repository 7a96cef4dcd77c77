"""Where an evolution stands: what it has come to, and from where it goes on."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import EvolutionState, Generation, Island, Population, population_from
from cgtorch.graphs import Graphs
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError
from cgtorch.improvement.journal import Standing


@dataclass(frozen=True)
class Budget:
    """When to stop searching.

    Attributes:
        generations: the most for one evolution.
        patience: generations without a better fitness, once all is solved in the models.
        stall: generations without a better fitness after which the search gives up.
        enough: fitness with which a candidate that solves all is good enough.
        satisfied: fitness from which on the scenarios that it does not solve are left to others,
            after `patience` generations without a better one.
        transitions: actions executed in the models after which no generation is begun.
    """

    generations: int = 150
    patience: int = 10
    stall: int = 40
    enough: float = 0.97
    satisfied: float = float("inf")
    transitions: float = float("inf")


@dataclass(frozen=True)
class Found:
    """What an evolution has come to so far.

    Attributes:
        champion: the best individual, as a population of one.
        solved: (B,) bool what it solves in the models.
        best: its fitness, -inf before the first generation.
        since: generations without a better one.
        generations: how many there were.
        transitions: actions executed in the models.
        seconds: what they took.
    """

    champion: Population
    solved: Tensor
    best: float
    since: int = 0
    generations: int = 0
    transitions: int = 0
    seconds: float = 0.0

    def after(self, generation: Generation, seconds: float) -> "Found":
        """With one more generation, which took so many seconds."""
        counted = replace(
            self,
            since=self.since + 1,
            generations=self.generations + 1,
            transitions=self.transitions + generation.transitions,
            seconds=self.seconds + seconds,
        )
        fitness = generation.best
        if fitness <= self.best + 1e-3:
            return counted
        champion, solved = generation.champion, generation.succeeded
        return replace(counted, champion=champion, solved=solved, best=fitness, since=0)

    def ends(self, budget: Budget) -> bool:
        """Whether the evolution is over."""
        good = self.best >= budget.enough or self.since >= budget.patience
        settled = self.best >= budget.satisfied and self.since >= budget.patience
        return (
            (bool(self.solved.all()) and good)
            or settled
            or self.since >= budget.stall
            or self.generations >= budget.generations
            or self.transitions >= budget.transitions
        )


def found_tensors(found: Found) -> dict[str, Tensor]:
    """What `found_from` reads again."""
    return {
        **_tensors("champion", found.champion),
        "solved": found.solved,
        "generations": torch.tensor(found.generations),
        "counts": torch.tensor([found.since, found.transitions]),
        "numbers": torch.tensor([found.best, found.seconds], dtype=torch.float64),
    }


def found_from(tensors: dict[str, Tensor], actions: ActionSet, scenarios: int) -> Found:
    """What an evolution had come to.

    Args:
        tensors: of `found_tensors`; where they come from a file, they may be anything.
        actions: what the graphs' nodes can be.
        scenarios: B, that the evolution is about.

    Raises:
        RunError: they are no such tensors.
    """
    with _damage():
        champion = _population("champion", tensors, actions)[:1]
        (since, transitions), (best, seconds) = (tensors[n].tolist() for n in ("counts", "numbers"))
        solved, generations = tensors["solved"], tensors["generations"].item()
        if type(generations) is not int or generations < 0:
            raise ValueError(f"it has had {generations} generations")
        if solved.shape != (scenarios,) or solved.dtype != torch.bool:
            raise ValueError(f"solved has shape {tuple(solved.shape)}, not ({scenarios},)")
        counts = int(since), generations, int(transitions)
        return Found(champion, solved, float(best), *counts, float(seconds))


def standing_of(found: Found, islands: Sequence[Island], count: int) -> Standing:
    """What `found_from` and `islands_from` read again.

    Args:
        found: what the evolution has come to.
        islands: those that this rank holds, with the generation that is evaluated next.
        count: how many islands there are.
    """
    # Looked at now: what is kept when a step is interrupted is written after more was drawn.
    held = dict(zip(ranks.held(count), map(island_tensors, islands), strict=True))
    own = held[min(held)]  # for its names and types, where the part is another rank's

    def part(number: int) -> dict[str, Tensor]:
        return ranks.fetched(held.get(number, own), number, count)

    parts = tuple(partial(part, number) for number in range(count))
    return Standing(found_tensors(found), parts, apart=len(held) < count)


def island_tensors(island: Island) -> dict[str, Tensor]:
    """What `island_from` reads again."""
    state = {"generator": island.generator.get_state()}
    return {**_tensors("population", island.state.population), **state}


def islands_from(
    standing: Standing, actions: ActionSet, generator: Generator, count: int
) -> list[Island]:
    """Of `count` islands those that this rank holds, from where they stood.

    Args:
        standing: of `standing_of`.
        actions: what the graphs' nodes can be.
        generator: is set to what the first island's was, and is that island's, if it is held.
        count: how many islands there are.

    Raises:
        RunError: they are no such tensors.
    """
    if len(standing.parts) != count:
        raise RunError(
            f"the state of an evolution is one of {len(standing.parts)} islands, not {count}; "
            "remove it"
        )
    done = int(standing.about["generations"])
    return [
        island_from(standing.parts[i](), actions, Generator() if i else generator, done)
        for i in ranks.held(count)
    ]


def island_from(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, generation: int
) -> Island:
    """An island from where it stood; see `islands_from`.

    Args:
        tensors: of `island_tensors`; where they come from a file, they may be anything.
        actions: what the graphs' nodes can be.
        generator: is set to what it was.
        generation: which one is evaluated next.
    """
    with _damage():
        population = _population("population", tensors, actions)
    restore(generator, tensors)
    return Island(EvolutionState(population, generation, population[:1], float("-inf")), generator)


def restore(generator: Generator, tensors: dict[str, Tensor]) -> None:
    """Set a generator to what `tensors` say it was; RunError if they do not."""
    with _damage():
        generator.set_state(tensors["generator"])


@contextmanager
def _damage() -> Iterator[None]:
    """A RunError for all that reading tensors that are something else can raise."""
    try:
        yield
    except (KeyError, ValueError, TypeError, RuntimeError) as e:
        reason = " ".join(str(e).split())[:200]
        raise RunError(f"the state of an evolution is damaged ({reason}); remove it") from e


def _tensors(part: str, population: Population) -> dict[str, Tensor]:
    values = {**vars(population.graphs), "strategy": population.strategy}
    return {f"{part}.{name}": value for name, value in values.items()}


def _population(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    names = [*(f.name for f in fields(Graphs)), "strategy"]
    return population_from({name: tensors[f"{part}.{name}"] for name in names}, actions)
