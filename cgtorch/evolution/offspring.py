"""A generation from the last one: the elite, and children by crossover and mutation at once."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.crossover import most_nodes, swapped
from cgtorch.evolution.drift import TAU
from cgtorch.evolution.operator_draws import Choices, Pairs
from cgtorch.evolution.parameters import changed, mark_new, marked
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
    size: int | None = None,
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
        size: how many are made, all if not given; each is what it would be among all.

    Returns:
        E + 2 Q individuals or `size`, the elite first, the children in the order of `crossover`,
        all of them with their nodes in the first slots. There are as many slots as the largest may
        need, however many there could be.

    Raises:
        IndexError: one of the elite or of the parents is none of the population.
    """
    graphs, same = population.graphs, len(elite)
    keys, slots = (key(generator), key(generator)), min(graphs.capacity + 1, capacity)
    way = compiled.bred if compiled.takes(graphs, graphs.parameters, slots) else bred
    made, strategy, first = way(population, elite, parents, keys, actions, capacity)
    made = made[:size]
    return changed(made, first, graphs.parameters, actions, strategy, same, generator, tau)


def bred(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """Marked graphs of the elite and of children of pairs, mutated, in torch.

    Args:
        population: who all are of.
        elite: (E,) long; see `offspring`, like all but the keys.
        parents: (2 Q,) long.
        keys: of all numbers of pairs, and of children.
        actions: what nodes can do.
        capacity: the most nodes that a child can have.

    Returns:
        E + 2 Q graphs, the strategies (E + 2 Q, S) of the elite and of parents, and after how many
        the new nodes of each action begin, and how many there are, as `mark_new` says.
    """
    graphs, rows = population.graphs, torch.cat([elite, parents])
    strategy = population.strategy.index_select(0, rows)
    width, theirs = most_nodes(graphs, rows), strategy[len(elite) :].float()
    slots = min(width + 1, capacity)
    pairs = Pairs(parents, theirs, keys[0], width)
    first = compacted(marked(graphs)[elite])
    same = narrowed(widened(first, max(graphs.capacity, slots)), slots)
    children = restructured(swapped(graphs, pairs), Choices(theirs, keys[1], slots), actions, slots)
    made, begins = mark_new(concatenate([same, children]), len(actions))
    return made, strategy, begins
