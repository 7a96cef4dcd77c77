"""Algorithm 2 as ask and tell: pure functions on a frozen state."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment.dry_run import kind
from cgtorch.evolution.fitness import WORST, Fitness, chance_of_success, episode_return
from cgtorch.evolution.lineages import Lineage, founded, raced, samples, told
from cgtorch.evolution.offspring import crossover, mutate, offspring
from cgtorch.evolution.population import (
    TAU,
    Crossover,
    Mutation,
    Population,
    check_offspring,
    initial_strategy,
    join,
    random_graphs,
    seeded_population,
    slim,
)
from cgtorch.evolution.selection import Selection, lexicase, ranking, tournament
from cgtorch.evolution.varied_graphs import varied_graphs
from cgtorch.graphs import compacted, resized
from cgtorch.ground.errors import DataError, SettingsError


@dataclass(frozen=True)
class EvolutionSettings:
    """How a population evolves.

    One can give one's own functions for `selection`, `fitness`, `crossover` and `mutation`. A value
    that cannot work is a SettingsError.

    Attributes:
        population: number of individuals, of each island.
        selection: how parents are chosen, `lexicase` or `tournament(rounds)`.
        fitness: what a run is worth.
        crossover: how two parents become two children.
        mutation: how children change.
        elite: best individuals that go on unchanged.
        capacity: the most nodes a graph can have.
        initial_nodes: fewest and most nodes of a first graph, before pruning.
        tau: variance of the drift of strategy parameters (eq. 2).
        islands: populations that evolve apart; see `cgtorch.evolution.islands`.
        migration: generations between two migrations.
        lineages: structures whose parameters are tuned at once; see `cgtorch.evolution.lineages`.
            None are if it is 0, and parameters change by mutation alone, as in the paper.
    """

    population: int = 400
    selection: Selection = lexicase
    fitness: Fitness = chance_of_success
    crossover: Crossover = crossover
    mutation: Mutation = mutate
    elite: int = 1
    capacity: int = 24
    initial_nodes: tuple[int, int] = (4, 12)
    tau: float = TAU
    islands: int = 1
    migration: int = 5
    lineages: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        if self.population < 2:
            raise SettingsError(f"population is {self.population}; give at least 2")
        if not 0 <= self.elite < self.population:
            raise SettingsError(f"elite is {self.elite}; give 0 to {self.population - 1}")
        low, high = self.initial_nodes
        if not 1 <= low <= high <= self.capacity:
            raise SettingsError(
                f"initial nodes are {low} to {high}; give a range within 1 to {self.capacity}"
            )
        for name in ("islands", "migration"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} is {getattr(self, name)}; give at least 1")
        if self.lineages < 0 or (self.lineages and self.islands > 1):
            raise SettingsError(
                f"lineages is {self.lineages}; give 0 or more, and 0 where there are islands"
            )
        if not 0 <= self.tau < float("inf"):
            raise SettingsError(f"tau is {self.tau}; give a finite variance of at least 0")


REWARDS = EvolutionSettings(
    population=48,
    selection=tournament(),
    fitness=episode_return,
    initial_nodes=(2, 2),
    lineages=4,
)
"""Settings for worlds with rewards, where every episode is one of the world itself."""


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
        draw = varied_graphs if settings.lineages else random_graphs
        graphs = draw(settings.population, actions, *sizes)
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
    order = ranking(fitness, state.population.graphs)
    return next_state(state, order, fitness, scores, settings, actions, generator)


def next_state(
    state: EvolutionState,
    order: Tensor,
    fitness: Tensor,
    scores: Tensor,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """`tell` unchecked: fitness (P,) and scores (P, B) have no NaN, `order` (P,) is best first."""
    if settings.lineages:
        return _next_of_lineages(state, order, fitness, scores, settings, actions, generator)
    return _next_bred(state, order, fitness, scores, settings, actions, generator)


def _next_of_lineages(
    state: EvolutionState,
    order: Tensor,
    fitness: Tensor,
    scores: Tensor,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """Samples of lineages as long as there are any, else a population that is bred."""
    best, found = int(order[0]), (fitness, scores, actions)
    if state.lineages:
        after = told(state.lineages, state.population, *found)
        lineages, ended = raced(after)
        assert state.parents is not None  # noqa: S101  they are there with lineages
        parents = state.parents.with_lineages(ended)
    else:
        lineages = founded(state.population, order, *found, settings.lineages)
        parents = Parents(state.population, fitness, scores)
        if state.parents is not None:
            parents = parents.with_others(state.parents)
    if lineages:
        return EvolutionState(
            population=samples(lineages, actions, generator),
            generation=state.generation + 1,
            best=state.population[best : best + 1],
            best_fitness=float(fitness[best]),
            lineages=lineages,
            parents=parents,
            fresh=state.fresh,
        )
    return _next_structures(state, parents, settings, actions, generator)


def _next_structures(
    state: EvolutionState,
    parents: Parents,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """A population of new structures: random ones, or children of all parents, in turn.

    Children go on from where lineages have come to, and can be caught there; random ones are not.
    """
    order = ranking(parents.fitness, parents.population.graphs)
    known = replace(state, population=parents.population, lineages=(), parents=None)
    about = order, parents.fitness, parents.scores, settings, actions, generator
    bred = _next_bred(known, *about)
    if not state.fresh:
        return replace(bred, fresh=True)
    size = settings.capacity, settings.initial_nodes, generator
    graphs = varied_graphs(settings.population, actions, *size)
    fresh = slim(Population(graphs, initial_strategy(len(graphs))))
    kept = parents.rows(order[: settings.elite])
    return replace(bred, population=fresh, parents=kept, distinct_parents=0, fresh=False)


def _next_bred(
    state: EvolutionState,
    order: Tensor,
    fitness: Tensor,
    scores: Tensor,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """The elite and children of the population."""
    population, size = state.population, settings.population
    elite, pairs = order[: settings.elite], (size - settings.elite + 1) // 2
    home = scores.device
    if settings.selection is not lexicase:  # others choose on the CPU
        order, scores = order.cpu(), scores.cpu()
    parents = settings.selection(order, scores, 2 * pairs, generator).to(home)
    elite, best = elite.to(home), int(order[0])
    if settings.crossover is crossover and settings.mutation is mutate:
        sizes = settings.capacity, settings.tau, size
        following = offspring(population, elite, parents, actions, generator, *sizes)
    else:
        children = _children(population, parents, settings, actions, generator)
        following = join(slim(population[elite]), children)[:size]
    return EvolutionState(
        population=following,
        generation=state.generation + 1,
        best=population[best : best + 1],
        best_fitness=float(fitness[best]),
        distinct_parents=len(parents.unique()),
    )


def _children(
    population: Population,
    parents: Tensor,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> Population:
    """As many children as parents (2 Q,), by operators of which one at least is of one's own."""
    graphs, q = population.graphs, len(parents) // 2
    slots = min(int(graphs.num_nodes.max()) + 1, settings.capacity)
    sizes = slots, graphs.edges.shape[2], graphs.parameters.shape[2]
    some = Population(resized(compacted(graphs), *sizes), population.strategy)
    children = settings.crossover(some[parents[:q]], some[parents[q:]], generator)
    children = settings.mutation(children, actions, generator, settings.tau)
    check_offspring(children, 2 * q, settings.capacity, actions)
    return children


def _check(fitness: Tensor, scores: Tensor | None, size: int) -> None:
    """DataError unless both are about a population of that size."""
    if not isinstance(fitness, Tensor) or fitness.shape != (size,):
        raise DataError(f"fitness is {kind(fitness)}; give a tensor ({size},), one of each")
    if scores is not None and (scores.dim() != 2 or len(scores) != size or not scores.shape[1]):
        raise DataError(f"scores are {kind(scores)}; give a tensor ({size}, B), B at least 1")
