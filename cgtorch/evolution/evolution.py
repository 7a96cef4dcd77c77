"""Algorithm 2 as ask and tell: pure functions on a frozen state."""

import torch
from torch import Generator, Tensor

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
from cgtorch.graphs import ActionSet
from cgtorch.ground.dry_run import kind
from cgtorch.ground.errors import DataError


def initial_state(
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
    seeds: Population | None = None,
) -> EvolutionState:
    """The first population: random, or half random and half `seeds` (section IV-B).

    Args:
        settings: How the population evolves.
        actions: What nodes can do.
        generator: A CPU generator of all random choices.
        seeds: Earlier individuals, whose actions come first in `actions`.

    Raises:
        GraphError: A seed has more nodes than `settings.capacity`.
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
    """The P individuals to evaluate next. They stay the same until `tell` is called.

    P is `settings.population`, or the number of samples of the lineages. All graphs have as many
    slots as the largest of them needs.
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
    """The next generation, given the results of this one (Algorithm 2, lines 7 to 12).

    Args:
        state: The state whose population was evaluated.
        fitness: (P,) on the CPU, in the order of `ask`. It decides on the elite and the best.
        settings: How the population evolves.
        actions: What nodes can do.
        generator: The generator of all random choices.
        scores: (P, B), one column per scenario or objective, for selection. Without them, the
            fitness is the only column.

    In both, more is better in any unit, and NaN counts as the worst.

    Raises:
        DataError: The fitness or the scores have a wrong shape.
        SettingsError: A crossover or mutation that you wrote returned an invalid population.
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
    """`tell` without validation: neither fitness nor scores may contain NaN."""
    how = next_alternating if settings.lineages else next_population
    return how(state, evaluated, settings, actions, generator)


def _check(fitness: Tensor, scores: Tensor | None, size: int) -> None:
    """DataError unless fitness and scores fit a population of that size."""
    if not isinstance(fitness, Tensor) or fitness.shape != (size,):
        raise DataError(
            f"fitness is {kind(fitness)}; give a tensor ({size},), one number for each individual"
        )
    if scores is not None and (scores.dim() != 2 or len(scores) != size or not scores.shape[1]):
        raise DataError(
            f"scores are {kind(scores)}; give a tensor ({size}, B) with B of at least 1"
        )
