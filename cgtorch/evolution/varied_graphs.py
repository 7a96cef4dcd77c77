"""Random graphs of as many kinds as possible, for small populations.

If every evaluation is an episode of the world, few graphs can be tried, and most random ones are
not worth it. A policy that acts for a whole episode is a loop, and a node outside the loop is idle.
So many graphs are drawn, and those are preferred whose nodes can all reach each other. The first
graph of each kind comes before the second of any. The kind of a graph is the sorted list of its
nodes' actions.
"""

from dataclasses import replace

import torch
from torch import Generator, Tensor

from cgtorch.evolution.population import random_graphs
from cgtorch.graphs import ActionSet, Graphs, reachable

DRAWN = 32
"""Number of graphs drawn for each one that is kept."""


def varied_graphs(
    size: int,
    actions: ActionSet,
    capacity: int,
    initial_nodes: tuple[int, int],
    generator: Generator,
) -> Graphs:
    """`size` graphs; the number of nodes before pruning is within `initial_nodes`."""
    drawn = random_graphs(DRAWN * size, actions, capacity, initial_nodes, generator)
    _, kind = drawn.action.sort(1).values.unique(dim=0, return_inverse=True)
    group = torch.where(looping(drawn), kind, kind + len(kind))
    rank = occurrence(group) + len(kind) * (group >= len(kind))
    return drawn[rank.argsort(stable=True)[:size]]


def looping(graphs: Graphs) -> Tensor:
    """(P,) bool, whether all nodes of a graph can reach each other."""
    every = torch.ones(len(graphs), dtype=torch.bool)
    for node in range(graphs.capacity):
        start = torch.full_like(graphs.start, node)
        there = graphs.used[:, node]
        all_reached = (reachable(replace(graphs, start=start)) >= graphs.used).all(1)
        every &= ~there | all_reached
    return every


def occurrence(group: Tensor) -> Tensor:
    """(P,) how often the same number occurred earlier in groups (P,)."""
    order = group.argsort(stable=True)
    ordered, place = group[order], torch.arange(len(group))
    begins = torch.ones_like(ordered, dtype=torch.bool)
    begins[1:] = ordered[1:] != ordered[:-1]
    first = torch.where(begins, place, 0).cummax(0).values
    return torch.empty_like(group).scatter_(0, order, place - first)
