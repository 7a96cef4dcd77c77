"""Individuals with their fitness and scores."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from cgtorch.evolution.population import Population, join
from cgtorch.evolution.selection import ranking


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Evaluated:
    """P individuals with their fitness (P,) and scores (P, B), as in `Evaluation`."""

    population: Population
    fitness: Tensor
    scores: Tensor

    @cached_property
    def order(self) -> Tensor:
        """(P,) long, from best to worst; of equally fit individuals, the smaller graph first."""
        return ranking(self.fitness, self.population.graphs)

    def rows(self, index: Tensor | slice) -> "Evaluated":
        """The individuals at `index` (k,)."""
        return Evaluated(self.population[index], self.fitness[index], self.scores[index])

    def with_others(self, others: "Evaluated") -> "Evaluated":
        """These individuals, followed by others."""
        return Evaluated(
            join(self.population, others.population),
            torch.cat([self.fitness, others.fitness]),
            torch.cat([self.scores, others.scores]),
        )
