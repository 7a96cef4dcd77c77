"""Crossover and mutation in one step."""

from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.choices import choices_for
from cgtorch.evolution.crossover import pairs_of, swapped
from cgtorch.evolution.mutation import TAU, finished
from cgtorch.evolution.population import Population
from cgtorch.evolution.structure import restructured


def offspring(
    population: Population,
    parents: Tensor,
    actions: ActionSet,
    generator: Generator,
    tau: float = TAU,
) -> Population:
    """Children of parents by `crossover` and `mutate`; parameters are copied once, not twice.

    Args:
        population: who parents are of.
        parents: (2 Q,) long, the first of each of Q pairs and then the second of each.
        actions: what nodes can do.
        generator: of all random choices.
        tau: variance of the drift in eq. 2.

    Returns:
        2 Q children, in the order of `crossover`.
    """
    graphs, strategy = population.graphs, population.strategy.index_select(0, parents)
    pairs = pairs_of(graphs, parents, strategy, generator)
    choices = choices_for(strategy, pairs.width, graphs.edges.shape[1:], generator)
    if compiled.takes(graphs, graphs.parameters):
        children = compiled.bred(graphs, pairs, choices, actions)
    else:
        children = restructured(swapped(graphs, pairs), choices, actions)
    return finished(children, graphs.parameters, strategy, actions, generator, tau)
