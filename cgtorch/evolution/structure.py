"""Mutations of nodes and edges (section IV-B) of all graphs at once, in torch.

Each is a function of the graphs and of uniform draws. A draw below a rate, divided by it, is
uniform again: it says which, too. `native/mutation.c` does the same to one graph at a time.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.operator_draws import Choices, numbers, parts
from cgtorch.evolution.population import STRATEGY
from cgtorch.evolution.sampling import nth_true, pick, uniform
from cgtorch.graphs import (
    NO_NODE,
    Graphs,
    compacted,
    narrowed,
    pruned,
    widened,
)


def restructured(graphs: Graphs, choices: Choices, actions: ActionSet, capacity: int) -> Graphs:
    """Every mutation of nodes and edges in turn, and nodes that nothing leads to pruned.

    Args:
        graphs: P of them, whose parameters are marks (`cgtorch.evolution.parameters`).
        choices: how they are mutated.
        actions: what nodes can be.
        capacity: slots of each in the end, as many as `choices.width` at least.

    Returns:
        The graphs, their nodes in the first slots; nodes that are new have no marks.
    """
    width, o = choices.width, graphs.edges.shape[2]
    rate = dict(zip(STRATEGY, choices.strategy.unbind(1), strict=True))
    draws = [uniform(x) for x in numbers(choices.key, len(graphs), parts(width, o))]
    add, delete, start, replaced, changed, heads = draws
    heads = heads.view(-1, width, o)
    graphs = compacted(graphs)
    dense = narrowed(widened(graphs, max(width, graphs.capacity)), width)
    dense = add_node(dense, actions, rate["add_node"], add)
    dense = delete_node(dense, rate["delete_node"], delete, heads)
    dense = replace_nodes(dense, actions, rate["replace_node"], replaced, heads)
    dense = change_edges(dense, rate["change_edge"], changed, heads)
    dense = pruned(new_start(dense, rate["new_start"], start))
    return widened(compacted(dense), capacity)


def add_node(graphs: Graphs, actions: ActionSet, rate: Tensor, draws: Tensor) -> Graphs:
    """A random node takes over one incoming edge of a node that has at least two.

    Its own edges go to random nodes; it has no parameters, or mark, yet. Graphs that are full, or
    without such an edge, stay.

    Args:
        graphs: P of them.
        actions: what the node can be.
        rate: (P,) probability.
        draws: (P, 3 + O) whether, which edge, which action, and heads.
    """
    p, n, o = graphs.edges.shape
    flat = graphs.edges.flatten(1)
    ones = (flat != NO_NODE).long()
    indegree = torch.zeros(p, n, dtype=torch.long).scatter_add_(1, flat.clamp_min(0), ones)
    spare = (flat != NO_NODE) & (indegree.gather(1, flat.clamp_min(0)) >= 2)
    adds = (draws[:, 0] < rate) & spare.any(1) & (~graphs.used).any(1)
    edge = nth_true(spare, draws[:, 1])
    action = pick(draws[:, 2], len(actions))
    heads = nth_true(graphs.used, draws[:, 3:])
    heads = torch.where(actions.has_edge[action], heads, NO_NODE)
    slot = graphs.used.long().argmin(1)
    row, slot, edge = adds.nonzero()[:, 0], slot[adds], edge[adds]

    out = replace(graphs, action=graphs.action.clone(), edges=graphs.edges.clone())
    out.action[row, slot] = action[adds]
    out.edges[row, slot] = heads[adds]
    out.edges[row, edge // o, edge % o] = slot
    return out


def delete_node(graphs: Graphs, rate: Tensor, draws: Tensor, heads: Tensor) -> Graphs:
    """A random node goes and edges into it turn to random others; two nodes always remain.

    Args:
        graphs: P of them.
        rate: (P,) probability.
        draws: (P, 3) whether, which node, and a new start.
        heads: (P, N, O) draws of new heads.
    """
    gone = nth_true(graphs.used, draws[:, 1])
    deletes = (draws[:, 0] < rate) & (graphs.num_nodes > 2)
    at = torch.zeros_like(graphs.used).scatter_(1, gone[:, None], deletes[:, None])
    rest = graphs.used & ~at
    into = (graphs.edges == gone[:, None, None]) & deletes[:, None, None]
    edges = torch.where(into, nth_true(rest, heads), graphs.edges)
    start = nth_true(rest, draws[:, 2])
    return Graphs(
        graphs.action.masked_fill(at, NO_NODE),
        edges.masked_fill(at[..., None], NO_NODE),
        graphs.parameters.masked_fill(at[..., None], 0),
        torch.where(deletes & (graphs.start == gone), start, graphs.start),
    )


def replace_nodes(
    graphs: Graphs, actions: ActionSet, rate: Tensor, draws: Tensor, heads: Tensor
) -> Graphs:
    """Each node may turn into a new one: action and edges; its parameters are zero.

    Args:
        graphs: P of them.
        actions: what the nodes can be.
        rate: (P,) probability.
        draws: (P, N) whether, and which action.
        heads: (P, N, O) draws of heads.
    """
    at = (draws < rate[:, None]) & graphs.used
    action = pick(draws / rate[:, None], len(actions))
    edges = torch.where(actions.has_edge[action], nth_true(graphs.used, heads), NO_NODE)
    return replace(
        graphs,
        action=torch.where(at, action, graphs.action),
        edges=torch.where(at[..., None], edges, graphs.edges),
        parameters=graphs.parameters.masked_fill(at[..., None], 0),
    )


def change_edges(graphs: Graphs, rate: Tensor, draws: Tensor, heads: Tensor) -> Graphs:
    """Each node may get a random new head on one of its edges.

    Args:
        graphs: P of them.
        rate: (P,) probability.
        draws: (P, N) whether, and which edge.
        heads: (P, N, O) draws of heads.
    """
    o = graphs.edges.shape[2]
    leads = graphs.edges != NO_NODE
    which = nth_true(leads.flatten(0, 1), (draws / rate[:, None]).flatten()).view_as(draws)
    here = (draws < rate[:, None])[..., None] & (torch.arange(o) == which[..., None]) & leads
    return replace(graphs, edges=torch.where(here, nth_true(graphs.used, heads), graphs.edges))


def new_start(graphs: Graphs, rate: Tensor, draws: Tensor) -> Graphs:
    """The start moves to a random node that has an edge to another node.

    Args:
        graphs: P of them.
        rate: (P,) probability.
        draws: (P, 2) whether, and which node.
    """
    slot = torch.arange(graphs.capacity)[:, None]
    leads = ((graphs.edges != NO_NODE) & (graphs.edges != slot)).any(2) & graphs.used
    moves = (draws[:, 0] < rate) & leads.any(1)
    return replace(graphs, start=torch.where(moves, nth_true(leads, draws[:, 1]), graphs.start))
