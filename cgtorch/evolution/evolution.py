"""Algorithm 2 as ask and tell: pure functions on a frozen state."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment.dry_run import kind
from cgtorch.evolution.alternating import next_alternating
from cgtorch.evolution.breeding import next_population
from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.fitness import WORST
from cgtorch.evolution.population import (
    Population,
    initial_strategy,
    seeded_population,
    slim,
)
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.evolution.state import EvolutionState
from cgtorch.ground.errors import DataError


def initial_state(
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
    seeds: Population | None = None,
) -> EvolutionState:
    """The first population: random, or half of it `seeds` (section IV-B).

    Seeds are earlier individuals, with the same actions first in their sets; GraphError if one has
    more nodes than `settings.capacity`. The generator, of all random choices, is a CPU one.
    """
    sizes = (settings.capacity, settings.initial_nodes, generator)
    if seeds is None:
        graphs = settings.first_graphs(settings.population, actions, *sizes)
        population = Population(graphs, initial_strategy(len(graphs)))
    else:
        population = seeded_population(settings.population, seeds, actions, *sizes)
    population = slim(population)
    return EvolutionState(population, 0, population[:1], float("-inf"))


def ask(state: EvolutionState) -> Population:
    """The P individuals to evaluate next, the same ones until `tell`.

    These are `settings.population`, or samples of lineages. Their graphs have as many slots as the
    largest may need, however many nodes there could be.
    """
    return state.population


def tell(
    state: EvolutionState,
    fitness: Tensor,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
    scores: Tensor | None = None,
) -> EvolutionState:
    """The next generation, given how this one did (Algorithm 2, lines 7 to 12).

    The fitness (P,) of the individuals, in the order of `ask` and on the CPU, decides on the elite
    and the best. Selection looks at scores (P, B), a column for each scenario or aim, and without
    them at the fitness. In each, more is better, whatever its unit, and NaN is the worst.

    Raises:
        DataError: fitness or scores are not of such a shape.
        SettingsError: a crossover or mutation of one's own has made what is no valid population.
    """
    _check(fitness, scores, len(state.population))
    fitness = torch.nan_to_num(fitness, nan=float("-inf"), neginf=float("-inf"))
    scores = fitness[:, None] if scores is None else scores
    scores = torch.nan_to_num(scores, nan=WORST, neginf=WORST)
    evaluated = Evaluated(state.population, fitness, scores)
    return next_state(state, evaluated, settings, actions, generator)


def next_state(
    state: EvolutionState,
    evaluated: Evaluated,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """`tell` unchecked, of individuals whose fitness and scores have no NaN."""
    how = next_alternating if settings.lineages else next_population
    return how(state, evaluated, settings, actions, generator)


def _check(fitness: Tensor, scores: Tensor | None, size: int) -> None:
    """DataError unless both are about a population of that size."""
    if not isinstance(fitness, Tensor) or fitness.shape != (size,):
        raise DataError(
            f"fitness is {kind(fitness)}; give a tensor ({size},), one number for each individual"
        )
    if scores is not None and (scores.dim() != 2 or len(scores) != size or not scores.shape[1]):
        raise DataError(
            f"scores are {kind(scores)}; give a tensor ({size}, B) with B of at least 1"
        )
