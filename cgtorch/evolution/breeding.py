"""The next population: the elite and the children (Algorithm 2, lines 7 to 12)."""

from torch import Generator, Tensor

from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.offspring import crossover, mutate, offspring
from cgtorch.evolution.population import Population, check_offspring, join, slim
from cgtorch.evolution.selection import lexicase
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.evolution.state import EvolutionState
from cgtorch.graphs import ActionSet, compacted, resized


def next_population(
    state: EvolutionState,
    evaluated: Evaluated,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """The next population: the elite of the evaluated individuals, and children."""
    population, size = evaluated.population, settings.population
    order, scores = evaluated.order, evaluated.scores
    elite, pairs = order[: settings.elite], (size - settings.elite + 1) // 2
    home = scores.device
    if settings.selection is not lexicase:  # others choose on the CPU
        order, scores = order.cpu(), scores.cpu()
    parents = settings.selection(order, scores, 2 * pairs, generator).to(home)
    elite, best = elite.to(home), int(order[0])
    if settings.crossover is crossover and settings.mutation is mutate:
        sizes = settings.capacity, settings.tau, size
        individuals = offspring(population, elite, parents, actions, generator, *sizes)
    else:
        children = _children(population, parents, settings, actions, generator)
        individuals = join(slim(population[elite]), children)[:size]
    return EvolutionState(
        population=individuals,
        generation=state.generation + 1,
        best=population[best : best + 1],
        best_fitness=float(evaluated.fitness[best]),
        distinct_parents=len(parents.unique()),
    )


def _children(
    population: Population,
    parents: Tensor,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> Population:
    """As many children as parents (2 Q,), where the user has replaced crossover or mutation."""
    graphs, q = population.graphs, len(parents) // 2
    slots = min(int(graphs.num_nodes.max()) + 1, settings.capacity)
    sizes = slots, graphs.edges.shape[2], graphs.parameters.shape[2]
    some = Population(resized(compacted(graphs), *sizes), population.strategy)
    children = settings.crossover(some[parents[:q]], some[parents[q:]], generator)
    children = settings.mutation(children, actions, generator, settings.tau)
    check_offspring(children, 2 * q, settings.capacity, actions)
    return children
