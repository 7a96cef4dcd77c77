"""Search in turns: a population of structures, then lineages of the best ones."""

from dataclasses import replace

from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.breeding import bred
from cgtorch.evolution.lineages import founded, raced, samples, told
from cgtorch.evolution.population import Population, initial_strategy, slim
from cgtorch.evolution.selection import ranking
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.evolution.state import EvolutionState, Parents


def next_in_turn(
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
    if not state.fresh:
        known = replace(state, population=parents.population, lineages=(), parents=None)
        about = order, parents.fitness, parents.scores, settings, actions, generator
        return replace(bred(known, *about), fresh=True)
    size = settings.capacity, settings.initial_nodes, generator
    graphs = settings.first_graphs(settings.population, actions, *size)
    best = int(order[0])
    return EvolutionState(
        population=slim(Population(graphs, initial_strategy(len(graphs)))),
        generation=state.generation + 1,
        best=parents.population[best : best + 1],
        best_fitness=float(parents.fitness[best]),
        parents=parents.rows(order[: settings.elite]),
        fresh=False,
    )
