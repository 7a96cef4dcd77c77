"""Where an evolution stands."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.evolution.lineages import Lineage
from cgtorch.evolution.population import Population, join


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Parents:
    """Individuals that children may come from, with what they achieved, as in `Evaluation`."""

    population: Population
    fitness: Tensor
    scores: Tensor

    def rows(self, index: Tensor) -> "Parents":
        """Those at `index` (k,)."""
        return Parents(self.population[index], self.fitness[index], self.scores[index])

    def with_others(self, others: "Parents") -> "Parents":
        """These, and others after them."""
        return Parents(
            join(self.population, others.population),
            torch.cat([self.fitness, others.fitness]),
            torch.cat([self.scores, others.scores]),
        )

    def with_lineages(self, lineages: Sequence[Lineage]) -> "Parents":
        """These, and what lineages have come to."""
        if not lineages:
            return self
        best = join(*(each.best for each in lineages))
        fitness = self.fitness.new_tensor([each.fitness for each in lineages])
        scores = torch.stack([each.scores for each in lineages]).to(self.scores)
        return self.with_others(Parents(best, fitness, scores))


@dataclass(frozen=True)
class EvolutionState:
    """Where an evolution stands.

    Attributes:
        population: the individuals to be evaluated next.
        generation: how many generations have been told.
        best: the best individual told so far in the last generation (a population of one).
        best_fitness: its fitness, -inf before the first generation.
        distinct_parents: of the population, 0 of one that was not bred.
        lineages: those that the population was sampled from; none if it was bred.
        parents: those of the next population, while there are lineages; before, who is to be among
            them.
        fresh: whether the next population that is not sampled is random, and not bred.
    """

    population: Population
    generation: int
    best: Population
    best_fitness: float
    distinct_parents: int = 0
    lineages: tuple[Lineage, ...] = ()
    parents: Parents | None = None
    fresh: bool = True
