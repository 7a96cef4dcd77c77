"""Crossover: swaps connected subgraphs, which are likely to be sub-solutions (section IV-B)."""

import torch
from torch import Tensor

from cgtorch.evolution.parameters import with_origins
from cgtorch.graphs import NO_NODE, Graphs, compacted, concatenate, narrowed, pruned, widened
from cgtorch.ground.counter_rng import BITS, fields, individual_words, nth_true, pick, uniform_from


def swapped(graphs: Graphs, parents: Tensor, rates: Tensor, key: int, width: int) -> Graphs:
    """Children (2 Q) of Q pairs, in torch; `native/engine/crossover.h` makes one pair at a time.

    Args:
        graphs: The P graphs of the population.
        parents: (2 Q,) long, the first parents of all pairs, then the second ones.
        rates: (2 Q, S) float32 strategies of the parents.
        key: Determines all random numbers.
        width: An upper bound of the number of nodes of a parent.

    The nodes of children are in their first slots, with origins in place of parameters
    (`cgtorch.evolution.parameters`).
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
