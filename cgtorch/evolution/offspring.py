"""Crossover and mutation in one step."""

from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.crossover import paired
from cgtorch.evolution.mutation import TAU, remade
from cgtorch.evolution.population import Population


def offspring(
    population: Population,
    parents: Tensor,
    actions: ActionSet,
    generator: Generator,
    tau: float = TAU,
) -> Population:
    """Children of parents: those of `crossover`, mutated by `mutate`, to the last bit.

    Parameters of parents are copied once, where a child has them, and not after each operator.

    Args:
        population: who parents are of.
        parents: (2 Q,) long, the first of each of Q pairs and then the second of each.
        actions: what nodes can do.
        generator: of all random choices.
        tau: variance of the drift in eq. 2.

    Returns:
        2 Q children, in the order of `crossover`.
    """
    graphs, strategy = population.graphs, population.strategy[parents]
    children = paired(graphs, parents, strategy, generator)
    return remade(children, graphs.parameters, strategy, actions, generator, tau)
