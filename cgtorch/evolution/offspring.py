"""A generation from the last one: the elite, and children by crossover and mutation at once."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.choices import Choices, Pairs
from cgtorch.evolution.crossover import most_nodes, swapped
from cgtorch.evolution.mutation import TAU, drift
from cgtorch.evolution.parameters import changed, marked
from cgtorch.evolution.population import Population
from cgtorch.evolution.sampling import key
from cgtorch.evolution.structure import restructured
from cgtorch.graphs import Graphs, compacted, concatenate, narrowed, widened


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
    keys, slots = (key(generator), key(generator)), min(graphs.capacity + 1, capacity)
    way = compiled.bred if compiled.takes(graphs, graphs.parameters, slots) else bred
    children = way(graphs, rows, first, strategy, keys, actions, capacity)
    made = changed(children, graphs.parameters, actions, strategy, first, generator)
    strategy[first:] = drift(strategy[first:], tau, generator)
    return Population(made, strategy)


def bred(
    graphs: Graphs,
    rows: Tensor,
    first: int,
    strategy: Tensor,
    keys: tuple[int, int],
    actions: ActionSet,
    capacity: int,
) -> Graphs:
    """Marked graphs of the elite and of children of pairs, mutated, in torch.

    Args:
        graphs: P of them.
        rows: (E + 2 Q,) long, the elite and then the parents; see `offspring`.
        first: E.
        strategy: (E + 2 Q, S) theirs.
        keys: of all numbers of pairs, and of children.
        actions: what nodes can do.
        capacity: the most nodes that a child can have.
    """
    width, theirs = most_nodes(graphs, rows), strategy[first:].float()
    slots = min(width + 1, capacity)
    pairs = Pairs(rows[first:], theirs, keys[0], width)
    elite = compacted(marked(graphs)[rows[:first]])
    same = narrowed(widened(elite, max(graphs.capacity, slots)), slots)
    children = restructured(swapped(graphs, pairs), Choices(theirs, keys[1], slots), actions, slots)
    return concatenate([same, children])
