"""Crossover: swap connected subgraphs, which are the likely sub-solutions (section IV-B)."""

import torch
from torch import Generator, Tensor

from cgtorch.evolution.population import Population
from cgtorch.evolution.sampling import bernoulli, choose, choose_many
from cgtorch.graphs import NO_NODE, Graphs, pruned


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
    a, b = first.graphs, second.graphs
    probability = (first.strategy[:, 0] + second.strategy[:, 0]) / 2
    crossed = bernoulli(probability, (), generator)
    half = torch.minimum(a.num_nodes, b.num_nodes) // 2
    k = 1 + (torch.rand(len(half), generator=generator) * half).long().clamp_max(half - 1)
    k = torch.where(crossed & (half > 0), k, 0)
    group_a, group_b = _group(a, generator), _group(b, generator)
    one = _graft(a, group_a, b, group_b, k, generator)
    two = _graft(b, group_b, a, group_a, k, generator)
    graphs = Graphs(
        *(torch.cat(pair) for pair in zip(vars(one).values(), vars(two).values(), strict=True))
    )
    return Population(pruned(graphs), torch.cat([first.strategy, second.strategy]))


def _group(graphs: Graphs, generator: Generator) -> Tensor:
    """(Q, N) long, slots in the order an undirected breadth-first search meets them.

    The search begins at a random node; within one distance the order is random.
    """
    distance = undirected_distance(graphs, choose(graphs.used, generator))
    jitter = torch.rand(distance.shape, generator=generator)
    return torch.argsort(distance + jitter, dim=1)


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


def _graft(
    host: Graphs,
    host_group: Tensor,
    donor: Graphs,
    donor_group: Tensor,
    k: Tensor,
    generator: Generator,
) -> Graphs:
    """The hosts with their first k group nodes replaced by the donors', by position."""
    q, n, o = host.edges.shape
    inside = torch.arange(n) < k[:, None]
    position = torch.argsort(donor_group, dim=1)  # slot of the donor → place in its group
    heads = donor.edges.gather(1, donor_group[..., None].expand(q, n, o))
    head_position = position.gather(1, heads.clamp_min(0).flatten(1))
    mapped = host_group.gather(1, head_position).view(q, n, o)
    within = (head_position < k[:, None]).view(q, n, o)
    elsewhere = choose_many(host.used, (n, o), generator)
    edges = torch.where(within, mapped, elsewhere)
    edges = torch.where(heads == NO_NODE, heads, edges)

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
