"""Algorithm 2 as ask and tell: from one generation to the next, on a frozen state."""

from dataclasses import dataclass, field, replace

import torch
from torch import Generator, Tensor

from cgtorch.evolution.fitness import WORST
from cgtorch.evolution.lineages import Lineage, next_lineages, samples
from cgtorch.evolution.operators import crossover, mutate, offspring
from cgtorch.evolution.population import (
    Population,
    check_offspring,
    initial_strategy,
    join,
    seeded_population,
    slim,
)
from cgtorch.evolution.selection import Evaluated, lexicase
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.graphs import ActionSet, compacted, resized
from cgtorch.graphs.action_set import AN_ACTION_SET
from cgtorch.ground.dry_run import kind
from cgtorch.ground.errors import DataError
from cgtorch.ground.given import of_kind


@dataclass(frozen=True)
class EvolutionState:
    """The state of an evolution, or of one of its islands.

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
        generator: The generator of all random choices.
    """

    population: Population
    generation: int
    best: Population
    best_fitness: float
    distinct_parents: int = 0
    lineages: tuple[Lineage, ...] = ()
    parents: Evaluated | None = None
    fresh: bool = True
    generator: Generator = field(default_factory=Generator)


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
        SettingsError: The seeds are no population, or something else is of another kind.
    """
    check_kinds(settings, actions, generator)
    if seeds is None:
        population = _random(settings, actions, generator, settings.population)
    else:
        of_kind(seeds, Population, "seeds", "a Population, such as that of `ask` or `Search.best`")
        sizes = settings.capacity, settings.initial_nodes, generator, settings.strategy
        population = slim(seeded_population(settings.population, seeds, actions, *sizes))
    return EvolutionState(population, 0, population[:1], float("-inf"), generator=generator)


def check_kinds(settings: object, actions: object, generator: object) -> None:
    """SettingsError unless these are what a search is made with."""
    of_kind(settings, EvolutionSettings, "settings", "EvolutionSettings")
    of_kind(actions, ActionSet, "actions", AN_ACTION_SET)
    of_kind(generator, Generator, "generator", "a torch.Generator")


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
    size = len(state.population)
    if not isinstance(fitness, Tensor) or fitness.shape != (size,):
        raise DataError(
            f"fitness is {kind(fitness)}; give a tensor ({size},), one number for each individual"
        )
    if scores is not None and (scores.dim() != 2 or len(scores) != size or not scores.shape[1]):
        raise DataError(
            f"scores are {kind(scores)}; give a tensor ({size}, B) with B of at least 1"
        )
    fitness = torch.nan_to_num(fitness, nan=float("-inf"), neginf=float("-inf"))
    scores = fitness[:, None] if scores is None else scores
    scores = torch.nan_to_num(scores, nan=WORST, neginf=WORST)
    evaluated = Evaluated(state.population, fitness, scores)
    return next_state(replace(state, generator=generator), evaluated, settings, actions)


def next_state(
    state: EvolutionState, evaluated: Evaluated, settings: EvolutionSettings, actions: ActionSet
) -> EvolutionState:
    """`tell` without validation: neither fitness nor scores may contain NaN.

    While lineages are running (`cgtorch.evolution.lineages`), the population consists of samples of
    them. Between, it consists alternately of random graphs and of children, which may inherit a
    local optimum with what lineages have tuned.
    """
    parents, lineages = evaluated, state.lineages
    if settings.lineages:
        about = lineages, state.parents, evaluated, settings.lineages, actions
        lineages, parents = next_lineages(*about)
    if lineages:
        drawn = samples(lineages, actions, state.generator)
        state = replace(state, lineages=lineages, parents=parents)
        return _after(state, evaluated, drawn)
    if settings.lineages and state.fresh:
        drawn = _random(settings, actions, state.generator, settings.population)
        few = parents.rows(parents.order[: settings.elite])
        return _after(replace(state, lineages=(), parents=few, fresh=False), parents, drawn)
    old = replace(settings, population=settings.population - settings.newcomers, newcomers=0)
    bred, distinct = _children(parents, old, actions, state.generator)
    if settings.newcomers:
        bred = join(bred, _random(settings, actions, state.generator, settings.newcomers))
    return _after(replace(state, lineages=(), parents=None, fresh=True), parents, bred, distinct)


def _after(
    state: EvolutionState, evaluated: Evaluated, population: Population, distinct_parents: int = 0
) -> EvolutionState:
    """The state with its next population, and with the best of those that were evaluated."""
    best = int(evaluated.order[0])
    return replace(
        state,
        population=population,
        generation=state.generation + 1,
        best=evaluated.population[best : best + 1],
        best_fitness=float(evaluated.fitness[best]),
        distinct_parents=distinct_parents,
    )


def _random(
    settings: EvolutionSettings, actions: ActionSet, generator: Generator, count: int
) -> Population:
    sizes = settings.capacity, settings.initial_nodes, generator
    graphs = settings.first_graphs(count, actions, *sizes)
    return slim(Population(graphs, initial_strategy(len(graphs), settings.strategy)))


def _children(
    evaluated: Evaluated, settings: EvolutionSettings, actions: ActionSet, generator: Generator
) -> tuple[Population, int]:
    """The elite and the children of selected parents, and the number of different parents."""
    population, order, scores = evaluated.population, evaluated.order, evaluated.scores
    elite, pairs = order[: settings.elite], (settings.population - settings.elite + 1) // 2
    home = scores.device
    if settings.selection is not lexicase:  # others choose on the CPU
        order, scores = order.cpu(), scores.cpu()
    parents = settings.selection(order, scores, 2 * pairs, generator).to(home)
    elite, distinct = elite.to(home), len(parents.unique())
    if settings.crossover is crossover and settings.mutation is mutate:
        sizes = settings.capacity, settings.tau, settings.population
        return offspring(population, elite, parents, actions, generator, *sizes), distinct
    graphs = population.graphs
    slots = min(int(graphs.num_nodes.max()) + 1, settings.capacity)
    sizes = slots, graphs.edges.shape[2], graphs.parameters.shape[2]
    some = Population(resized(compacted(graphs), *sizes), population.strategy)
    children = settings.crossover(some[parents[:pairs]], some[parents[pairs:]], generator)
    children = settings.mutation(children, actions, generator, settings.tau)
    check_offspring(children, 2 * pairs, settings.capacity, actions)
    return join(slim(population[elite]), children)[: settings.population], distinct
