"""Where an evolution stands: what it has come to, and from where it goes on."""

from dataclasses import dataclass, fields, replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.errors import RunError
from cgtorch.evolution import EvolutionState, Generation, Population, population_from
from cgtorch.graphs import Graphs


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


@dataclass(frozen=True)
class Found:
    """What an evolution has come to so far.

    Attributes:
        champion: the best individual, as a population of one.
        solved: (B,) bool what it solves in the models.
        best: its fitness, -1 before the first generation.
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
        fitness = float(generation.fitness[generation.best])
        if fitness <= self.best + 1e-3:
            return counted
        champion, solved = generation.champion, generation.succeeded
        return replace(counted, champion=champion, solved=solved, best=fitness, since=0)

    def ends(self, budget: Budget) -> bool:
        """Whether the evolution is over."""
        good = self.best >= budget.enough or self.since >= budget.patience
        return (
            (bool(self.solved.all()) and good)
            or self.since >= budget.stall
            or self.generations >= budget.generations
            or self.transitions >= budget.transitions
        )


def standing_tensors(
    found: Found, population: Population | None, generator: Generator
) -> dict[str, Tensor]:
    """What `standing_from` reads again.

    Args:
        found: what the evolution has come to.
        population: the generation that is evaluated next, None where the evolution is over.
        generator: as it is before that generation.
    """
    parts = {"champion": found.champion} | ({"population": population} if population else {})
    return {
        **{
            f"{part}.{name}": value
            for part, those in parts.items()
            for name, value in {**vars(those.graphs), "strategy": those.strategy}.items()
        },
        "solved": found.solved,
        "generations": torch.tensor(found.generations),
        "counts": torch.tensor([found.since, found.transitions]),
        "numbers": torch.tensor([found.best, found.seconds], dtype=torch.float64),
        "generator": generator.get_state(),
    }


def standing_from(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, scenarios: int
) -> tuple[Found, EvolutionState | None]:
    """What an evolution had come to, and from where it goes on, None where it is over.

    Args:
        tensors: of `standing_tensors`; where they come from a file, they may be anything.
        actions: what the graphs' nodes can be.
        generator: is set to what it was.
        scenarios: B, that the evolution is about.

    Raises:
        RunError: they are no such tensors.
    """
    try:
        champion = _population("champion", tensors, actions)[:1]
        (since, transitions), (best, seconds) = (tensors[n].tolist() for n in ("counts", "numbers"))
        solved, generations = tensors["solved"], tensors["generations"].item()
        if type(generations) is not int or generations < 0:
            raise ValueError(f"it has had {generations} generations")
        if solved.shape != (scenarios,) or solved.dtype != torch.bool:
            raise ValueError(f"solved has shape {tuple(solved.shape)}, not ({scenarios},)")
        found = Found(champion, solved, best, int(since), generations, int(transitions), seconds)
        state = None
        if "population.action" in tensors:
            population = _population("population", tensors, actions)
            state = EvolutionState(population, generations, population[:1], float("-inf"))
        generator.set_state(tensors["generator"])
    except (KeyError, ValueError, TypeError, RuntimeError) as e:
        reason = " ".join(str(e).split())[:200]
        raise RunError(f"the state of an evolution is damaged ({reason}); remove it") from e
    return found, state


def _population(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    names = [*(f.name for f in fields(Graphs)), "strategy"]
    return population_from({name: tensors[f"{part}.{name}"] for name in names}, actions)
