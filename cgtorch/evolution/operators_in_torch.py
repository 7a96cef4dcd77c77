"""The genetic operators of a whole population in torch: `operators` without compiled code.

Crossover and mutations of structure work on graphs that carry, in place of parameters, the origin
of each node's parameters. So parameters are copied only once, for the nodes that remain. An origin
is r + 1 for row r of all parents' parameters, -r - 1 for row r of those drawn for new nodes, and 0
for a new node without a row.

Each mutation is a function of graphs and uniform numbers. Given u < rate, u / rate is uniform on
[0, 1) and selects the target. `native/engine/operators.h` does the same to one graph at a time.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.evolution.population import STRATEGY, Population, drifted, factors
from cgtorch.graphs import (
    NO_NODE,
    ActionSet,
    Graphs,
    compacted,
    concatenate,
    narrowed,
    pruned,
    widened,
    without,
)
from cgtorch.ground.counter_rng import (
    BITS,
    FRESH,
    fields,
    individual_words,
    keys,
    normal_from,
    nth_true,
    pick,
    uniform_from,
    words,
)

RATE, SIGMA = STRATEGY.index("mutate_parameter"), STRATEGY.index("sigma")


def breed(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor]:
    """See `cgtorch.evolution.operators.breed`; new nodes are not numbered yet."""
    graphs, rows = population.graphs, torch.cat([elite, parents])
    strategy = population.strategy.index_select(0, rows)
    rates = strategy[len(elite) :].float()
    width = int(graphs.num_nodes[rows].max()) if len(rows) else 0
    children, slots = swapped(graphs, parents, rates, keys[0], width), graphs.capacity
    if actions is not None:
        slots = min(width + 1, capacity)
        children = restructured(children, rates, keys[1], actions, slots)
    first = compacted(with_origins(graphs)[elite])
    first = narrowed(widened(first, max(graphs.capacity, slots)), slots)
    return concatenate([first, children]), strategy


def with_origins(graphs: Graphs) -> Graphs:
    """The graphs with origins (P, N, 1) in place of parameters: 1 + the index among all slots."""
    origins = torch.arange(1, graphs.action.numel() + 1).view_as(graphs.action) * graphs.used
    return replace(graphs, parameters=origins[..., None])


def swapped(graphs: Graphs, parents: Tensor, rates: Tensor, key: int, width: int) -> Graphs:
    """Children of pairs of parents (2 Q,) with strategies `rates` (2 Q, S), in their first slots.

    The key determines all random numbers; no parent has more than `width` nodes.
    """
    q, (_, n, o) = len(parents) // 2, graphs.edges.shape
    both = compacted(with_origins(graphs)[parents])
    a, b = narrowed(both[:q], width), narrowed(both[q:], width)
    # Whether a pair is crossed and how many nodes are swapped; of either parent where its group
    # begins, and the order of nodes; of either child its heads.
    sizes = [1, 1, 1, 1, width, width, width * o, width * o]
    crosses, share, *begins, jitter_a, jitter_b, heads_a, heads_b = individual_words(key, q, sizes)
    half = torch.minimum(a.num_nodes, b.num_nodes) // 2
    probability = rates[:, 0].view(2, -1).sum(0) / 2
    crossed = (uniform_from(crosses)[:, 0] < probability) & (half > 0)
    size = torch.where(crossed, 1 + pick(uniform_from(share)[:, 0], half), 0)
    group_a, group_b = group(a, begins[0], jitter_a), group(b, begins[1], jitter_b)
    one = graft(a, group_a, b, group_b, size, uniform_from(heads_a).view(q, width, o))
    two = graft(b, group_b, a, group_a, size, uniform_from(heads_b).view(q, width, o))
    return widened(compacted(pruned(concatenate([one, two]))), n)


def group(graphs: Graphs, begin: Tensor, jitter: Tensor) -> Tensor:
    """(Q, N) long, the slots in the order in which an undirected breadth-first search meets them.

    The random word `begin` (Q, 1) selects the first node. The words `jitter` (Q, N) order nodes at
    the same distance.
    """
    distance = undirected_distance(graphs, nth_true(graphs.used, uniform_from(begin))[:, 0])
    return torch.argsort((distance << BITS) + fields(jitter), dim=1, stable=True)


def undirected_distance(graphs: Graphs, source: Tensor) -> Tensor:
    """(Q, N) long, the number of edges from `source` (Q,) to each slot; N if it is unreachable."""
    q, n, o = graphs.edges.shape
    tail = torch.arange(n)[:, None].expand(n, o)
    heads = torch.where(graphs.edges == NO_NODE, n, graphs.edges)
    near = torch.zeros(q, n + 1, n + 1)
    row = torch.arange(q)[:, None, None]
    near[row, tail, heads] = 1
    near = near[:, :n, :n]
    near = near + near.mT
    seen = torch.zeros(q, n).scatter_(1, source[:, None], 1)
    distance = torch.where(seen > 0, 0, n)
    for step in range(1, n):
        wave = (torch.einsum("qn,qnm->qm", seen, near) > 0) & (seen == 0)
        if not wave.any():
            break
        distance = distance.masked_fill(wave, step)
        seen = seen + wave
    return distance


def graft(
    host: Graphs,
    host_group: Tensor,
    donor: Graphs,
    donor_group: Tensor,
    k: Tensor,
    heads: Tensor,
) -> Graphs:
    """The hosts with their first k group nodes replaced by those of the donors, one by one.

    Edges that leave the group lead to nodes selected by the uniform numbers `heads` (Q, N, O).
    """
    q, n, o = host.edges.shape
    inside = torch.arange(n) < k[:, None]
    position = torch.argsort(donor_group, dim=1)  # slot of the donor → place in its group
    before = donor.edges.gather(1, donor_group[..., None].expand(q, n, o))
    head_position = position.gather(1, before.clamp_min(0).flatten(1))
    mapped = host_group.gather(1, head_position).view(q, n, o)
    within = (head_position < k[:, None]).view(q, n, o)
    edges = torch.where(within, mapped, nth_true(host.used, heads))
    edges = torch.where(before == NO_NODE, NO_NODE, edges)

    def put(old: Tensor, new: Tensor) -> Tensor:
        """New values at the group's first k slots, in group order."""
        shape = (q, n, *[1] * (old.dim() - 2))
        index = host_group.view(shape).expand_as(old)
        kept = old.gather(1, index)
        return old.scatter(1, index, torch.where(inside.view(shape), new, kept))

    width = donor_group[..., None].expand_as(donor.parameters)
    return Graphs(
        put(host.action, donor.action.gather(1, donor_group)),
        put(host.edges, edges),
        put(host.parameters, donor.parameters.gather(1, width)),
        host.start,
    )


def restructured(graphs: Graphs, rates: Tensor, key: int, actions: ActionSet, slots: int) -> Graphs:
    """P graphs of so many slots after all mutations of nodes and edges in turn, pruned.

    Nodes are in the first slots, before and after; new ones have origin 0. `rates` are (P, S).
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


def perturb_parameters(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    tau: float,
    same: int,
    key: int,
) -> tuple[Tensor, Tensor]:
    """Parameters (P, N, K) and strategies (P, S) of graphs; see `native/engine/operators.c`.

    New nodes with a row get their parameters from `fresh` (F, K). One random word per parameter
    decides whether it changes, and by how much.
    """
    strategy, own = strategy[: len(graphs)], keys(key, len(graphs))
    out = at_origins(graphs.parameters, old, fresh)
    _draw_standard(out, graphs, actions, own)
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    before = count.cumsum(1) - count
    row, slot = count.nonzero(as_tuple=True)
    column = torch.arange(out.shape[2])
    random = words(own[row, None], before[row, slot][:, None] + column)
    rate, sigma = strategy.float()[row][:, [RATE, SIGMA]].split(1, 1)
    changes = (uniform_from(random) < rate) & (row >= same)[:, None]
    changes &= column < count[row, slot][:, None]
    values = out[row, slot]
    out[row, slot] = torch.where(changes, values + normal_from(random) * sigma, values)
    return out, torch.cat([strategy[:same], drifted(strategy[same:], factors(own[same:], tau))])


def _draw_standard(out: Tensor, graphs: Graphs, actions: ActionSet, keys: Tensor) -> None:
    """Draw standard normal parameters for new nodes with origin 0, in place."""
    new = graphs.used & (graphs.parameters[..., 0] == 0)
    new &= actions.standard[graphs.action.clamp_min(0)] != 0
    row, slot = new.nonzero(as_tuple=True)
    column = torch.arange(out.shape[2])
    drawn = normal_from(words(keys[row, None], FRESH + slot[:, None] * out.shape[2] + column))
    count = actions.num_parameters[graphs.action[row, slot]]
    out[row, slot] = torch.where(column < count[:, None], drawn, 0).to(out)


def at_origins(origins: Tensor, old: Tensor, fresh: Tensor) -> Tensor:
    """(P, N, K) the rows that origins (P, N, 1) name, zero for origin 0."""
    table = torch.cat([fresh.flip(0), old.new_zeros(1, old.shape[2]), old.flatten(0, 1)])
    return table[origins[..., 0] + len(fresh)]
