"""Where an evolution stands."""

from dataclasses import dataclass

from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.lineages import Lineage
from cgtorch.evolution.population import Population


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
    parents: Evaluated | None = None
    fresh: bool = True
