"""The state of an evolution."""

from dataclasses import dataclass

from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.lineages import Lineage
from cgtorch.evolution.population import Population


@dataclass(frozen=True)
class EvolutionState:
    """The state of an evolution.

    Attributes:
        population: The individuals to evaluate next.
        generation: Number of generations that `tell` has received.
        best: The best individual of the last generation, a population of one.
        best_fitness: Its fitness, -inf before the first generation.
        distinct_parents: Number of different parents of the population; 0 if it has none.
        lineages: The lineages that the population was sampled from; empty if it was bred.
        parents: While lineages run, the parents of the next population. Otherwise, further
            individuals that will be among these.
        fresh: Whether the next new structures are random graphs rather than children. It is used
            with lineages only.
    """

    population: Population
    generation: int
    best: Population
    best_fitness: float
    distinct_parents: int = 0
    lineages: tuple[Lineage, ...] = ()
    parents: Evaluated | None = None
    fresh: bool = True
