"""Mutation of graphs, parameters and strategy (section IV-B and eq. 2)."""

from torch import Generator

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.drift import TAU
from cgtorch.evolution.operator_draws import choices_for
from cgtorch.evolution.parameters import changed, mark_new, marked
from cgtorch.evolution.population import Population
from cgtorch.evolution.structure import restructured


def mutate(
    population: Population, actions: ActionSet, generator: Generator, tau: float = TAU
) -> Population:
    """Every mutation in turn, each with its individual's own rate, then eq. 2 on the rates.

    Add a node, delete a node, replace nodes, change an edge of nodes, choose a new start; nodes
    that the start does not lead to are pruned; last, perturb parameters. The graphs stay valid.

    The children are the same to the last bit whatever way the operators run, compiled for the CPU
    or in torch: all choices follow from numbers that are functions of the individual's place.
    """
    graphs, strategy = marked(population.graphs), population.strategy
    old, capacity = population.graphs.parameters, graphs.capacity
    nodes = int(graphs.num_nodes.max()) if len(graphs) else 0
    choices = choices_for(strategy, nodes, capacity, generator)
    if compiled.takes(graphs, old):
        made, first = compiled.restructured(graphs, choices, actions, capacity)
    else:
        made, first = mark_new(restructured(graphs, choices, actions, capacity), len(actions))
    return changed(made, first, old, actions, strategy, 0, generator, tau)
