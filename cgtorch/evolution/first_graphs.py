"""Random graphs of first populations."""

from dataclasses import replace

import torch
from torch import Generator, Tensor

from cgtorch.graphs import NO_NODE, ActionSet, Graphs, pruned, reachable
from cgtorch.graphs.action import own

DRAWN = 64  # graphs that `varied_graphs` draws for each one that it keeps
LASTING = 4  # first graphs of a kind that repeat an action for ever


def random_graphs(
    size: int,
    actions: ActionSet,
    capacity: int,
    initial_nodes: tuple[int, int],
    generator: Generator,
) -> Graphs:
    """The graphs of `random_population`, with as many slots as `initial_nodes` allows."""
    low, high = initial_nodes
    count = torch.randint(low, high + 1, (size,), generator=generator)
    action = torch.randint(len(actions), (size, capacity), generator=generator)
    heads = torch.rand(size, capacity, actions.outcome_capacity, generator=generator)
    # All is drawn for as many nodes as there may be, and kept for as many as there are.
    parameters = actions.initial_parameters(action, generator, high)
    start = torch.rand(size, generator=generator)
    graphs = _structures(actions, count, action[:, :high], heads[:, :high], start)
    return pruned(replace(graphs, parameters=parameters))


def _structures(
    actions: ActionSet, count: Tensor, action: Tensor, heads: Tensor, start: Tensor
) -> Graphs:
    """Graphs without parameters, of which the first `count` (P,) of N slots are nodes.

    They have the actions (P, N). Numbers in [0, 1) choose where edges lead, `heads` (P, N, O), and
    where graphs start, `start` (P,).
    """
    used = torch.arange(action.shape[1]) < count[:, None]
    edges = torch.where(
        actions.has_edge[action] & used[..., None], (heads * count[:, None, None]).long(), NO_NODE
    )
    nothing = heads.new_empty(*action.shape, 0)
    return Graphs(action.masked_fill(~used, NO_NODE), edges, nothing, (start * count).long())


def varied_graphs(
    size: int,
    actions: ActionSet,
    capacity: int,
    initial_nodes: tuple[int, int],
    generator: Generator,
) -> Graphs:
    """Random graphs of as many kinds as possible, for small populations; see `random_graphs`.

    A policy that acts for a whole episode is a loop, and a node outside the loop is soon idle. So
    those graphs are preferred that are loops (`looping`). The first of each kind, which is the
    sorted list of its nodes' actions, comes before the second of any. Beside the second to fifth
    of these comes one that acts for ever by what was seen first (`lasting`), as some tasks need.
    """
    low, high = initial_nodes
    shape = DRAWN * size, high
    count = torch.randint(low, high + 1, shape[:1], generator=generator)
    action = torch.randint(len(actions), shape, generator=generator)
    heads = torch.rand(*shape, actions.outcome_capacity, generator=generator)
    start = torch.rand(shape[0], generator=generator)
    drawn = pruned(_structures(actions, count, action, heads, start))
    _, kind = drawn.action.sort(1).values.unique(dim=0, return_inverse=True)
    loops = looping(drawn, actions)
    lasts = lasting(drawn, actions) & ~loops
    place = occurrence(kind + len(kind) * torch.where(loops, 0, torch.where(lasts, 1, 2)))
    rank = torch.where(
        loops, place, torch.where(lasts & (place < LASTING), 1 + place, place + len(kind))
    )
    kept = drawn[rank.argsort(stable=True)[:size]]
    return replace(kept, parameters=actions.parameters_of(kept.action, generator))


def looping(graphs: Graphs, actions: ActionSet) -> Tensor:
    """(P,) bool, whether a graph acts, and all of its nodes are visited again and again.

    All nodes have to reach each other. Where actions have steps, a graph needs one, and its start
    has to lead to a node that sends a message.
    """
    followed, _, every = _followed(graphs, actions)
    for node in range(graphs.capacity):
        every &= ~graphs.used[:, node] | (_from(followed, node) >= graphs.used).all(1)
    return every


def lasting(graphs: Graphs, actions: ActionSet) -> Tensor:
    """(P,) bool, whether a graph acts again and again, as all of its nodes lead to steps.

    So does what follows a step. Messages are sent as for `looping`, but later steps may repeat the
    first one.
    """
    followed, steps, every = _followed(graphs, actions)
    for node in range(graphs.capacity):
        every &= ~graphs.used[:, node] | (_from(followed, node) & steps).any(1)
    return every


def _followed(graphs: Graphs, actions: ActionSet) -> tuple[Graphs, Tensor, Tensor]:
    """The graphs with the edges that are followed, which nodes (P, N) are steps, and who (P,) acts.

    From the first message on steps can be carried out, so the edges by which they fail lead
    nowhere.
    """
    control = torch.tensor([own(action, "request") == "control" for action in actions.actions])
    sends = (torch.tensor([action.message_size for action in actions.actions]) > 0) & ~control
    steps, sends = (graphs.used & each[graphs.action] for each in (control, sends))
    edges, first = graphs.edges.clone(), graphs.edges.clone()
    edges[..., 1:].masked_fill_(steps[..., None], NO_NODE)
    first[..., :1].masked_fill_(steps[..., None], NO_NODE)
    begins = reachable(replace(graphs, edges=first)) & sends
    acts = (begins.any(1) & steps.any(1)) | ~control.any()
    return replace(graphs, edges=edges), steps, acts


def _from(graphs: Graphs, node: int) -> Tensor:
    """(P, N) bool, a node and all nodes that it leads to."""
    return reachable(replace(graphs, start=torch.full_like(graphs.start, node)))


def occurrence(group: Tensor) -> Tensor:
    """(P,) how often the same number occurred earlier in groups (P,)."""
    counts = group.unique(return_counts=True)[1]
    first = (counts.cumsum(0) - counts).repeat_interleave(counts)
    place = torch.arange(len(group)) - first
    return torch.empty_like(group).scatter_(0, group.argsort(stable=True), place)
