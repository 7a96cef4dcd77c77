"""A search as an object: ask for graphs, tell what they are worth."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import torch
from safetensors.torch import save
from torch import Generator, Tensor

from cgtorch.evolution.evolution import ask, initial_state, tell
from cgtorch.evolution.island_tensors import (
    damage,
    island_from,
    island_tensors,
    population_named,
    population_tensors,
)
from cgtorch.evolution.islands import Island
from cgtorch.evolution.population import Population
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.graphs import ActionSet, Graphs, Skill, merged
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_bytes, tensors_of, write_bytes

MAX_BYTES = 2**30
"""The size of the largest file that `Search.load` reads."""


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
        self._island = Island(state, generator)
        self.best, self.best_fitness = state.population[:1], float("-inf")

    @property
    def generation(self) -> int:
        """The number of generations that were told."""
        return self._island.state.generation

    def ask(self) -> Graphs:
        """The P graphs to evaluate next; the same ones until `tell` is called."""
        return ask(self._island.state).graphs

    def tell(self, fitness: Tensor | Sequence[float], scores: Tensor | None = None) -> None:
        """Breed the next generation from the fitness (P,) of this one.

        More is better, and NaN is the worst. With `scores` (P, B), one column for each scenario or
        objective, these choose the parents. DataError for other shapes.
        """
        values = torch.as_tensor(fitness, dtype=torch.float32)
        state, generator = self._island.state, self._island.generator
        after = tell(state, values, self.settings, self.actions, generator, scores)
        if after.best_fitness > self.best_fitness:
            self.best, self.best_fitness = after.best, after.best_fitness
        self._island = replace(self._island, state=after)

    def skill(self, name: str, max_transitions: int = 20) -> Skill:
        """The best individual as a skill."""
        return Skill(name, merged(self.best.graphs), self.actions, max_transitions)

    def save(self, path: Path | str) -> None:
        """Write the whole state of the search to one file; RunError if that is not possible."""
        numbers = torch.tensor([self.generation, self.best_fitness], dtype=torch.float64)
        best = population_tensors("best", self.best)
        found = {**island_tensors(self._island), **best, "numbers": numbers}
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
        search._island = island_from(tensors, actions, Generator(), int(generation))
        return search
