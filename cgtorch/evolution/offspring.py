"""Children of a generation: crossover, mutation, and both at once with the elite (section IV-B).

Children are the same to the last bit whatever way the operators run, compiled for the CPU or in
torch: all choices follow from numbers that are functions of the individual's place.
"""

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.crossover import swapped
from cgtorch.evolution.parameters import changed, copied, with_new_origins, with_origins
from cgtorch.evolution.population import STRATEGY, TAU, Population
from cgtorch.evolution.structure import restructured
from cgtorch.graphs import Graphs, compacted, concatenate, narrowed, widened
from cgtorch.ground.counter_rng import random_key


def crossover(first: Population, second: Population, generator: Generator) -> Population:
    """Two children of each pair of parents.

    In each parent the k nodes that an undirected breadth-first search from a random node meets
    first are swapped node by node, with k uniform in 1 … half of the smaller parent. Edges within
    a group keep their shape; edges that leave it go to random nodes of the new graph. A pair is
    crossed with the mean of the parents' crossover probabilities, else copied. Parameters are
    never mixed within a node.

    Args:
        first: Q parents.
        second: Q parents.
        generator: of all random choices.

    Returns:
        2 Q children, those that take the frame of the first parents before the others.
    """
    graphs = concatenate([first.graphs, second.graphs])
    parents = Population(graphs, torch.cat([first.strategy, second.strategy]))
    every, keys = torch.arange(len(graphs)), (random_key(generator), 0)
    children = _bred(parents, every[:0], every, keys, None, graphs.capacity)[0]
    return Population(copied(children, graphs.parameters), parents.strategy)


def mutate(
    population: Population, actions: ActionSet, generator: Generator, tau: float = TAU
) -> Population:
    """Every mutation in turn, each with its individual's own rate, then eq. 2 on the rates.

    Add a node, delete a node, replace nodes, change an edge of nodes, choose a new start; nodes
    that the start does not lead to are pruned; last, perturb parameters. The graphs stay valid.
    """
    graphs, strategy, p = population.graphs, population.strategy, len(population)
    rates = strategy.clone()
    rates[:, STRATEGY.index("crossover")] = 0
    if p % 2:  # somebody who does not change makes up a pair with the last one
        graphs, rates = concatenate([graphs, graphs[:1]]), pad(rates, (0, 0, 0, 1))
    every, keys = torch.arange(len(graphs)), (0, random_key(generator))
    alone = Population(graphs, rates)
    made, _, first = _bred(alone, every[:0], every, keys, actions, graphs.capacity)
    made = widened(made[:p], graphs.capacity)
    old = population.graphs.parameters
    return changed(made, first, old, actions, strategy, 0, generator, tau)


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

    Nothing is copied twice, parameters of nodes that do not remain not even once. All have their
    nodes in the first slots, of which there are as many as the largest may need.

    Args:
        population: who all are of.
        elite: (E,) long, those that go on unchanged and come first.
        parents: (2 Q,) long, the first of each of Q pairs and then the second of each.
        actions: what nodes can do.
        generator: of all random choices.
        capacity: the most nodes that a child can have.
        tau: variance of the drift in eq. 2.
        size: how many are made, E + 2 Q if not given; each is what it would be among all.

    Raises:
        IndexError: one of the elite or of the parents is none of the population.
    """
    keys, old = (random_key(generator), random_key(generator)), population.graphs.parameters
    made, strategy, first = _bred(population, elite, parents, keys, actions, capacity)
    return changed(made[:size], first, old, actions, strategy, len(elite), generator, tau)


def _bred(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """See `bred_in_torch`."""
    graphs, slots = population.graphs, min(population.graphs.capacity + 1, capacity)
    way = compiled.bred if compiled.takes(graphs, graphs.parameters, slots) else bred_in_torch
    return way(population, elite, parents, keys, actions, capacity)


def bred_in_torch(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """The elite (E,) and children of parents (2 Q,), which without actions are not mutated.

    Their graphs, with origins in place of parameters; the strategies (E + 2 Q, S) of the elite and
    of parents; and the numbers of `with_new_origins`. The keys are those of pairs and of children.
    """
    graphs, rows = population.graphs, torch.cat([elite, parents])
    strategy = population.strategy.index_select(0, rows)
    width = int(graphs.num_nodes[rows].max()) if len(rows) else 0
    rates = strategy[len(elite) :].float()
    children = swapped(graphs, parents, rates, keys[0], width)
    if actions is None:
        slots = graphs.capacity
    else:
        slots = min(width + 1, capacity)
        children = restructured(children, rates, keys[1], actions, slots)
    first = compacted(with_origins(graphs)[elite])
    first = narrowed(widened(first, max(graphs.capacity, slots)), slots)
    made, begins = with_new_origins(concatenate([first, children]), len(actions or ()))
    return made, strategy, begins
