"""Crossover: swap connected subgraphs, which are the likely sub-solutions (section IV-B)."""

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled
from cgtorch.evolution.operator_draws import Pairs, numbers, pair_parts
from cgtorch.evolution.parameters import copied, marked
from cgtorch.evolution.population import Population
from cgtorch.evolution.sampling import BITS, fields, key, nth_true, pick, uniform
from cgtorch.graphs import (
    NO_NODE,
    Graphs,
    compacted,
    concatenate,
    narrowed,
    pruned,
    widened,
)


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
    strategy, word = torch.cat([first.strategy, second.strategy]), key(generator)
    if compiled.takes(graphs, graphs.parameters):
        children = compiled.swapped(graphs, strategy, word)
    else:
        every = torch.arange(len(graphs))
        pairs = Pairs(every, strategy.float(), word, most_nodes(graphs, every))
        children = swapped(graphs, pairs)
    return Population(copied(children, graphs.parameters), strategy)


def most_nodes(graphs: Graphs, rows: Tensor) -> int:
    """Nodes of the largest of the graphs `rows` (n,)."""
    return int(graphs.num_nodes[rows].max()) if len(rows) else 0


def swapped(graphs: Graphs, pairs: Pairs) -> Graphs:
    """Children (2 Q) of pairs, in torch; `native/crossover.h` makes them one pair after the other.

    They are marked (`cgtorch.evolution.parameters`): marks point to the parameters of `graphs`.
    Their nodes are in the first slots.
    """
    parents, width, q = pairs.parents, pairs.width, len(pairs)
    n, o = graphs.edges.shape[1:]
    both = compacted(marked(graphs)[parents])
    a, b = narrowed(both[:q], width), narrowed(both[q:], width)
    crosses, share, *begins, jitter_a, jitter_b, heads_a, heads_b = numbers(
        pairs.key, q, pair_parts(width, o)
    )
    half = torch.minimum(a.num_nodes, b.num_nodes) // 2
    probability = pairs.strategy[:, 0].view(2, -1).sum(0) / 2
    crossed = (uniform(crosses)[:, 0] < probability) & (half > 0)
    size = torch.where(crossed, 1 + pick(uniform(share)[:, 0], half), 0)
    group_a, group_b = group(a, begins[0], jitter_a), group(b, begins[1], jitter_b)
    one = graft(a, group_a, b, group_b, size, uniform(heads_a).view(q, width, o))
    two = graft(b, group_b, a, group_a, size, uniform(heads_b).view(q, width, o))
    return widened(compacted(pruned(concatenate([one, two]))), n)


def group(graphs: Graphs, begin: Tensor, jitter: Tensor) -> Tensor:
    """(Q, N) long, slots in the order an undirected breadth-first search meets them.

    The search begins at the node that the word `begin` (Q, 1) draws; within one distance the order
    is that of words `jitter` (Q, N).
    """
    distance = undirected_distance(graphs, nth_true(graphs.used, uniform(begin))[:, 0])
    return torch.argsort((distance << BITS) + fields(jitter), dim=1, stable=True)


def undirected_distance(graphs: Graphs, source: Tensor) -> Tensor:
    """(Q, N) long, edges between `source` (Q,) and each slot; N where there is no way."""
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
    """The hosts with their first k group nodes replaced by the donors', by position.

    Edges that leave the group go where `heads` (Q, N, O), by position, draws.
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
        """New values at the group's slots, in group order, where they are within the first k."""
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
