"""Mutations of nodes and edges (section IV-B) of all graphs at once, in torch.

Each is a function of the graphs and of uniform draws. Given u < rate, u / rate is uniform on [0, 1)
and says which. `native/engine/mutation.h` does the same to one graph at a time.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.population import STRATEGY
from cgtorch.graphs import NO_NODE, Graphs, compacted, narrowed, pruned, widened, without
from cgtorch.ground.counter_rng import individual_words, nth_true, pick, uniform_from


def restructured(graphs: Graphs, rates: Tensor, key: int, actions: ActionSet, slots: int) -> Graphs:
    """Every mutation of nodes and edges in turn, and nodes that nothing leads to pruned.

    Graphs have their nodes in the first of their slots, before and after it, and origins in place
    of parameters (`cgtorch.evolution.parameters`), 0 for new nodes. Rates are the strategies (P, S)
    in float32; all numbers follow from the key.
    """
    o, rate = graphs.edges.shape[2], dict(zip(STRATEGY, rates.unbind(1), strict=True))
    # To add, to delete, to move the start; to replace, to change, and heads of all edges.
    words = individual_words(key, len(graphs), [3 + o, 3, 2, slots, slots, slots * o])
    add, delete, start, replaced, changed, heads = (uniform_from(x) for x in words)
    heads = heads.view(-1, slots, o)
    graphs = narrowed(widened(graphs, max(slots, graphs.capacity)), slots)
    graphs = add_node(graphs, actions, rate["add_node"], add)
    graphs = delete_node(graphs, rate["delete_node"], delete, heads)
    graphs = replace_nodes(graphs, actions, rate["replace_node"], replaced, heads)
    graphs = change_edges(graphs, rate["change_edge"], changed, heads)
    return compacted(pruned(new_start(graphs, rate["new_start"], start)))


def add_node(graphs: Graphs, actions: ActionSet, rate: Tensor, draws: Tensor) -> Graphs:
    """A random node takes over one incoming edge of a node that has at least two.

    Its own edges go to random nodes; it has no parameters, or origin, yet. Graphs that are full, or
    without such an edge, stay. Draws (P, 3 + O) say whether, which edge, which action, and heads.
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

    Draws (P, 3) say whether, which node, and a new start, those of heads (P, N, O) where edges go.
    """
    gone = nth_true(graphs.used, draws[:, 1])
    deletes = (draws[:, 0] < rate) & (graphs.num_nodes > 2)
    at = torch.zeros_like(graphs.used).scatter_(1, gone[:, None], deletes[:, None])
    rest = graphs.used & ~at
    into = (graphs.edges == gone[:, None, None]) & deletes[:, None, None]
    edges = torch.where(into, nth_true(rest, heads), graphs.edges)
    moves = deletes & (graphs.start == gone)
    start = torch.where(moves, nth_true(rest, draws[:, 2]), graphs.start)
    return without(replace(graphs, edges=edges, start=start), at)


def replace_nodes(
    graphs: Graphs, actions: ActionSet, rate: Tensor, draws: Tensor, heads: Tensor
) -> Graphs:
    """Each node may turn into a new one: action and edges; its parameters are zero.

    Draws (P, N) say whether, and which action, those of heads (P, N, O) where edges go.
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

    Draws (P, N) say whether, and which edge, those of heads (P, N, O) where it goes.
    """
    o = graphs.edges.shape[2]
    leads = graphs.edges != NO_NODE
    which = nth_true(leads.flatten(0, 1), (draws / rate[:, None]).flatten()).view_as(draws)
    here = (draws < rate[:, None])[..., None] & (torch.arange(o) == which[..., None]) & leads
    return replace(graphs, edges=torch.where(here, nth_true(graphs.used, heads), graphs.edges))


def new_start(graphs: Graphs, rate: Tensor, draws: Tensor) -> Graphs:
    """The start moves to a random node with an edge to another: draws (P, 2), whether and which."""
    slot = torch.arange(graphs.capacity)[:, None]
    leads = ((graphs.edges != NO_NODE) & (graphs.edges != slot)).any(2) & graphs.used
    moves = (draws[:, 0] < rate) & leads.any(1)
    return replace(graphs, start=torch.where(moves, nth_true(leads, draws[:, 1]), graphs.start))
