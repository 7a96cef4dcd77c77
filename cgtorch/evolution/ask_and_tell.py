"""A search as an object: ask for graphs, tell what they are worth; and its state in files."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self

import torch
from safetensors.torch import save
from torch import Generator, Tensor

from cgtorch.evolution.cma import Distribution
from cgtorch.evolution.evolution import EvolutionState, ask, initial_state, tell
from cgtorch.evolution.lineages import RECENT, Lineage
from cgtorch.evolution.population import Population, population_from
from cgtorch.evolution.selection import Evaluated
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.graphs import ActionSet, Graphs, Skill, merged
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_bytes, tensors_of, write_bytes

MAX_BYTES = 2**30
"""The size of the largest file that `Search.load` reads."""
VECTORS = ("mean", "covariance", "path", "step_path")
"""The tensors of a `Distribution`."""


class Search:
    """A search with a fitness of your own, generation by generation.

        search = Search(actions, population=100, seed=0)
        for _ in range(20):
            search.tell(fitness_of(search.ask()))
        skill = search.skill("mine")

    With the fitness of eq. 3 it is the same search as `evolve`.

    Attributes:
        actions: What nodes can do.
        settings: How the population evolves.
        best: The best individual so far, one graph; the first of the population before any is told.
        best_fitness: Its fitness, -inf before the first generation.
    """

    def __init__(
        self, actions: ActionSet, *, seed: int = 0, seeds: Population | None = None, **settings: Any
    ):
        """Begin a search.

        Args:
            actions: What nodes can do.
            seed: The seed of all its random numbers.
            seeds: Earlier individuals, which become half of the first population.
            settings: Of `EvolutionSettings`, such as `population` and `capacity`.
        """
        self.actions, self.settings = actions, EvolutionSettings(**settings)
        generator = Generator().manual_seed(seed)
        state = initial_state(self.settings, actions, generator, seeds)
        self._state, self.best, self.best_fitness = state, state.best, state.best_fitness

    @property
    def generation(self) -> int:
        """The number of generations that were told."""
        return self._state.generation

    def ask(self) -> Graphs:
        """The P graphs to evaluate next; the same ones until `tell` is called."""
        return ask(self._state).graphs

    def tell(self, fitness: Tensor | Sequence[float], scores: Tensor | None = None) -> None:
        """Breed the next generation from the fitness (P,) of this one.

        More is better, and NaN is the worst. With `scores` (P, B), one column for each scenario or
        objective, these choose the parents. DataError for other shapes.
        """
        values = torch.as_tensor(fitness, dtype=torch.float32)
        own = self.settings, self.actions, self._state.generator
        self._state = after = tell(self._state, values, *own, scores)
        if after.best_fitness > self.best_fitness:
            self.best, self.best_fitness = after.best, after.best_fitness

    def skill(self, name: str, max_transitions: int = 20) -> Skill:
        """The best individual as a skill."""
        return Skill(name, merged(self.best.graphs), self.actions, max_transitions)

    def save(self, path: Path | str) -> None:
        """Write the whole state of the search to one file; RunError if that is not possible."""
        numbers = torch.tensor([self.generation, self.best_fitness], dtype=torch.float64)
        best = population_tensors("best", self.best)
        found = {**state_tensors(self._state), **best, "numbers": numbers}
        write_bytes(path, save({name: value.clone() for name, value in found.items()}))

    @classmethod
    def load(cls, path: Path | str, actions: ActionSet, **settings: Any) -> Self:
        """A search as it was saved, with the same actions and settings; RunError if it is damaged.

        It goes on to the same results.
        """
        search = cls.__new__(cls)
        search.actions, search.settings = actions, EvolutionSettings(**settings)
        with damage():
            tensors = tensors_of(read_bytes(path, MAX_BYTES))
            generation, search.best_fitness = tensors["numbers"].tolist()
            search.best = population_named("best", tensors, actions)
        if not 0 <= generation < 2**53:
            raise RunError(f"{str(path)!r} has had {generation} generations; it is damaged")
        search._state = state_from(tensors, actions, Generator(), int(generation))
        return search


def population_tensors(part: str, population: Population) -> dict[str, Tensor]:
    """The tensors of a population, by name."""
    values = {**vars(population.graphs), "strategy": population.strategy}
    return {f"{part}.{name}": value for name, value in values.items()}


def state_tensors(state: EvolutionState) -> dict[str, Tensor]:
    """The tensors that `state_from` reads, of the state of an evolution or of one island."""
    return {
        **population_tensors("population", state.population),
        "generator": state.generator.get_state(),
        **_lineage_tensors(state),
    }


def state_from(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, generation: int
) -> EvolutionState:
    """A state that evaluates this generation next, from untrusted `state_tensors`."""
    with damage():
        population = population_named("population", tensors, actions)
        best = population[:1], float("-inf")
        state = EvolutionState(population, generation, *best, generator=generator)
        state = _with_lineages(state, tensors, actions)
    restore(generator, tensors)
    return state


def restore(generator: Generator, tensors: dict[str, Tensor]) -> None:
    """Set a generator to the state in `tensors`; RunError if there is no valid one."""
    with damage():
        generator.set_state(tensors["generator"])


@contextmanager
def damage() -> Iterator[None]:
    """Turn any exception from reading damaged tensors into a RunError."""
    try:
        yield
    except (KeyError, ValueError, TypeError, RuntimeError) as e:
        reason = " ".join(str(e).split())[:200]
        raise RunError(f"the checkpoint of an evolution is damaged ({reason}); remove it") from e


def population_named(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    """The population that `population_tensors` named; ValueError or KeyError if there is none."""
    names = [*(f.name for f in fields(Graphs)), "strategy"]
    return population_from({name: tensors[f"{part}.{name}"] for name in names}, actions)


def _lineage_tensors(state: EvolutionState) -> dict[str, Tensor]:
    """The tensors that `_with_lineages` reads; none without lineages and parents."""
    found: dict[str, Tensor] = {}
    if state.lineages or state.parents is not None or not state.fresh:
        found["turns"] = torch.tensor([len(state.lineages), int(state.fresh)])
    if state.parents is not None:
        found |= population_tensors("parents", state.parents.population)
        found |= {"parents.fitness": state.parents.fitness, "parents.scores": state.parents.scores}
    for number, lineage in enumerate(state.lineages):
        part, about = f"lineage {number}", lineage.distribution
        recent = [*lineage.recent, *[float("nan")] * (RECENT - len(lineage.recent))]
        found |= population_tensors(part, lineage.best)
        found |= {f"{part}.{name}": getattr(about, name) for name in VECTORS}
        numbers = [lineage.fitness, lineage.level, about.step, *recent]
        found[f"{part}.numbers"] = torch.tensor(numbers, dtype=torch.float64)
        found[f"{part}.counts"] = torch.tensor([lineage.since, about.updates, len(lineage.recent)])
        found[f"{part}.scores"] = lineage.scores
    return found


def _with_lineages(
    state: EvolutionState, tensors: dict[str, Tensor], actions: ActionSet
) -> EvolutionState:
    """The state with lineages and parents, if the tensors contain any.

    KeyError, ValueError, TypeError or RuntimeError if they do not fit together.
    """
    if "turns" not in tensors:
        return state
    count, fresh = tensors["turns"].tolist()
    parents = None
    if "parents.fitness" in tensors:
        parents = Evaluated(
            population_named("parents", tensors, actions),
            tensors["parents.fitness"],
            tensors["parents.scores"],
        )
        if not len(parents.population) == len(parents.fitness) == len(parents.scores):
            raise ValueError("parents and what they achieved differ in number")
    lineages = tuple(_lineage(f"lineage {number}", tensors, actions) for number in range(count))
    return replace(state, lineages=lineages, parents=parents, fresh=bool(fresh))


def _lineage(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Lineage:
    fitness, level, step, *recent = tensors[f"{part}.numbers"].tolist()
    since, updates, known = tensors[f"{part}.counts"].tolist()
    vectors = {name: tensors[f"{part}.{name}"] for name in VECTORS}
    sizes = {len(vector) for vector in vectors.values()}
    if len(sizes) != 1 or not all(bool(vector.isfinite().all()) for vector in vectors.values()):
        raise ValueError("a lineage's distribution is not one of finite numbers")
    return Lineage(
        best=population_named(part, tensors, actions)[:1],
        fitness=fitness,
        scores=tensors[f"{part}.scores"],
        distribution=Distribution(step=step, updates=updates, **vectors),
        recent=tuple(recent[:known]),
        level=level,
        since=since,
    )
