"""Mutations of nodes and edges (section IV-B), of all graphs at once, in torch.

Each mutation is a function of graphs and uniform numbers. Given u < rate, u / rate is uniform on
[0, 1) and selects the target. `native/engine/mutation.h` does the same to one graph at a time.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.evolution.population import STRATEGY
from cgtorch.graphs import NO_NODE, ActionSet, Graphs, compacted, narrowed, pruned, widened, without
from cgtorch.ground.counter_rng import individual_words, nth_true, pick, uniform_from


def restructured(graphs: Graphs, rates: Tensor, key: int, actions: ActionSet, slots: int) -> Graphs:
    """The graphs after all mutations of nodes and edges in turn, with unreachable nodes pruned.

    Args:
        graphs: P graphs with origins in place of parameters (`cgtorch.evolution.parameters`); new
            nodes get origin 0. Nodes are in the first slots, before and after.
        rates: (P, S) float32 strategies.
        key: Determines all random numbers.
        actions: What nodes can do.
        slots: Number of slots of the result.
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
    """A random new node takes over one incoming edge of a node that has at least two.

    The edges of the new node lead to random nodes. Its origin is 0. A full graph, or one without
    such an edge, stays as it is. `draws` (P, 3 + O) decide whether, on which edge, with which
    action, and with which heads.
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
    """A random node is deleted, and edges into it lead to random others; two nodes always remain.

    `draws` (P, 3) decide whether, which node, and on a new start; `heads` (P, N, O) where edges
    lead.
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
    """Each node may become a new one, with a random action, random edges, and origin 0.

    `draws` (P, N) decide whether, and on the action; `heads` (P, N, O) decide where edges lead.
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

    `draws` (P, N) decide whether, and on which edge; `heads` (P, N, O) decide where it leads.
    """
    o = graphs.edges.shape[2]
    leads = graphs.edges != NO_NODE
    which = nth_true(leads.flatten(0, 1), (draws / rate[:, None]).flatten()).view_as(draws)
    here = (draws < rate[:, None])[..., None] & (torch.arange(o) == which[..., None]) & leads
    return replace(graphs, edges=torch.where(here, nth_true(graphs.used, heads), graphs.edges))


def new_start(graphs: Graphs, rate: Tensor, draws: Tensor) -> Graphs:
    """The start may move to a random node that has an edge to another; `draws` (P, 2) decide."""
    slot = torch.arange(graphs.capacity)[:, None]
    leads = ((graphs.edges != NO_NODE) & (graphs.edges != slot)).any(2) & graphs.used
    moves = (draws[:, 0] < rate) & leads.any(1)
    return replace(graphs, start=torch.where(moves, nth_true(leads, draws[:, 1]), graphs.start))
