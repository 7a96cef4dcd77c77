"""Alternating search: a population of new structures, then lineages of its best structures."""

from dataclasses import replace

from torch import Generator

from cgtorch.evolution.breeding import next_population
from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.lineages import (
    after_samples,
    new_lineages,
    samples,
    successive_halving,
    with_lineages,
)
from cgtorch.evolution.population import Population, initial_strategy, slim
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.evolution.state import EvolutionState
from cgtorch.graphs import ActionSet


def next_alternating(
    state: EvolutionState,
    evaluated: Evaluated,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """The next population, given how the last one did.

    While lineages are running, the population consists of samples of them. Otherwise it consists of
    new structures. See `cgtorch.evolution.lineages`.
    """
    if state.lineages:
        lineages, ended = successive_halving(after_samples(state.lineages, evaluated, actions))
        assert state.parents is not None  # noqa: S101  they are there with lineages
        parents = with_lineages(state.parents, ended)
    else:
        lineages = new_lineages(evaluated, actions, settings.lineages)
        parents = evaluated
        if state.parents is not None:
            parents = parents.with_others(state.parents)
    if lineages:
        best = int(evaluated.order[0])
        return EvolutionState(
            population=samples(lineages, actions, generator),
            generation=state.generation + 1,
            best=evaluated.population[best : best + 1],
            best_fitness=float(evaluated.fitness[best]),
            lineages=lineages,
            parents=parents,
            fresh=state.fresh,
        )
    return _next_structures(state, parents, settings, actions, generator)


def _next_structures(
    state: EvolutionState,
    parents: Evaluated,
    settings: EvolutionSettings,
    actions: ActionSet,
    generator: Generator,
) -> EvolutionState:
    """A population of new structures: alternately random graphs, and children of all parents.

    Children inherit what lineages have tuned, so they may inherit a local optimum as well. Random
    graphs do not.
    """
    if not state.fresh:
        children = next_population(state, parents, settings, actions, generator)
        return replace(children, fresh=True)
    order = parents.order
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
