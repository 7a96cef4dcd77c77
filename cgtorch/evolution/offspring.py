"""A generation from the last one: the elite, and children by crossover and mutation at once."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.choices import Choices, Pairs, choices_for
from cgtorch.evolution.crossover import pairs_of, swapped
from cgtorch.evolution.mutation import TAU, drift
from cgtorch.evolution.parameters import changed, marked
from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.evolution.structure import restructured
from cgtorch.graphs import Graphs, compacted, concatenate, narrowed, widened

RATE, SIGMA = STRATEGY.index("mutate_parameter"), STRATEGY.index("sigma")


def offspring(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    actions: ActionSet,
    generator: Generator,
    capacity: int,
    tau: float = TAU,
) -> Population:
    """The elite, and children of parents by `crossover` and `mutate`.

    Nothing is copied twice, parameters of nodes that do not remain not even once.

    Args:
        population: who all are of.
        elite: (E,) long, those that go on unchanged.
        parents: (2 Q,) long, the first of each of Q pairs and then the second of each.
        actions: what nodes can do.
        generator: of all random choices.
        capacity: the most nodes that a child can have.
        tau: variance of the drift in eq. 2.

    Returns:
        E + 2 Q individuals, the elite first, the children in the order of `crossover`, all of them
        with their nodes in the first slots. There are as many slots as the largest may need,
        however many there could be.
    """
    graphs, rows, first = population.graphs, torch.cat([elite, parents]), len(elite)
    strategy = population.strategy.index_select(0, rows)
    theirs = strategy[first:]
    pairs = pairs_of(graphs, rows, first, theirs, generator)
    choices = choices_for(theirs, pairs.width, capacity, generator)
    slots = choices.width
    way = compiled.bred if compiled.takes(graphs, graphs.parameters, slots) else bred
    children = way(graphs, elite, pairs, choices, actions)
    rate, sigma = strategy[:, RATE].float().clone(), strategy[:, SIGMA].float()
    rate[:first] = 0
    made = changed(children, graphs.parameters, actions, rate, sigma, generator)
    strategy[first:] = drift(theirs, tau, generator)
    return Population(made, strategy)


def bred(
    graphs: Graphs, elite: Tensor, pairs: Pairs, choices: Choices, actions: ActionSet
) -> Graphs:
    """Marked graphs of the elite (E,) and of children of pairs, mutated, in torch."""
    room = max(graphs.capacity, choices.width)
    same = narrowed(widened(compacted(marked(graphs)[elite]), room), choices.width)
    children = restructured(swapped(graphs, pairs), choices, actions, choices.width)
    return concatenate([same, children])
