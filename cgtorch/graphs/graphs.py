"""Computational graphs as a dataclass of tensors (section IV-A), and their validity (section IV-B).

A graph is valid if its start exists, every non-terminal outcome of every node leads to a node, and
every node can be reached from the start.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.graphs.action_set import ActionSet
from cgtorch.ground.errors import GraphError

NO_NODE = -1


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Graphs:
    """P computational graphs of up to N nodes.

    A node is a slot, and unused slots may be anywhere. A node has one edge per outcome.

    Attributes:
        action: (P, N) long, index into the action set, `NO_NODE` in unused slots.
        edges: (P, N, O) long, the slot that each outcome leads to; `NO_NODE` for terminal outcomes,
            for outcomes that the action does not have, and in unused slots.
        parameters: (P, N, K) float, zero beyond the action's number of parameters.
        start: (P,) long, the slot of the start node.
    """

    action: Tensor
    edges: Tensor
    parameters: Tensor
    start: Tensor

    def __len__(self) -> int:
        """The number of graphs, P."""
        return self.action.shape[0]

    @property
    def capacity(self) -> int:
        """N, the number of node slots of each graph."""
        return self.action.shape[1]

    @property
    def used(self) -> Tensor:
        """(P, N) bool, slots that hold a node."""
        return self.action != NO_NODE

    @property
    def num_nodes(self) -> Tensor:
        """(P,) long."""
        return self.used.sum(1)

    def __getitem__(self, index: Tensor | slice) -> "Graphs":
        """The graphs at `index`, with all their slots."""
        if isinstance(index, slice) and index.indices(len(self)) == (0, len(self), 1):
            return self
        if isinstance(index, Tensor) and index.dtype == torch.long:  # three times as fast
            return Graphs(*(x.index_select(0, index) for x in vars(self).values()))
        return Graphs(*(x[index] for x in vars(self).values()))

    def to(self, device: torch.device | str) -> "Graphs":
        """The same graphs on another device."""
        return Graphs(*(x.to(device) for x in vars(self).values()))


def concatenate(graphs: Sequence[Graphs]) -> Graphs:
    """One batch of all graphs, which must have the same N, O and K."""
    columns = zip(*(vars(g).values() for g in graphs), strict=True)
    return Graphs(*map(torch.cat, columns))


def resized(graphs: Graphs, nodes: int, outcomes: int, parameters: int) -> Graphs:
    """The graphs with other capacities; GraphError if they do not fit.

    Call `compacted` first to reduce the number of nodes.
    """

    def grow(x: Tensor, shape: tuple[int, ...], fill: float) -> Tensor:
        out = x.new_full((len(x), *shape), fill)
        part = tuple(slice(min(a, b)) for a, b in zip(shape, x.shape[1:], strict=True))
        out[:, *part] = x[:, *part]
        if (out != fill).sum() < (x != fill).sum():
            raise GraphError(
                f"graphs of {int(graphs.num_nodes.max())} nodes do not fit into {nodes} nodes, "
                f"{outcomes} outcomes and {parameters} parameters; give more"
            )
        return out

    return Graphs(
        grow(graphs.action, (nodes,), NO_NODE),
        grow(graphs.edges, (nodes, outcomes), NO_NODE),
        grow(graphs.parameters, (nodes, parameters), 0.0),
        graphs.start,
    )


def compacted(graphs: Graphs) -> Graphs:
    """The same graphs with their nodes moved to the first slots, in order."""
    order = torch.argsort((~graphs.used).long(), dim=1, stable=True)
    place = torch.argsort(order, dim=1)

    def taken(x: Tensor) -> Tensor:  # rows of x (P, N, ...) in the new order
        return x.gather(1, order.view(*order.shape, *[1] * (x.dim() - 2)).expand_as(x))

    return Graphs(
        taken(graphs.action),
        heads_in(taken(graphs.edges), place),
        taken(graphs.parameters),
        place.gather(1, graphs.start[:, None])[:, 0],
    )


def heads_in(edges: Tensor, values: Tensor) -> Tensor:
    """(P, N, O) the values (P, N) of the nodes that edges lead to, `NO_NODE` without an edge."""
    found = values.gather(1, edges.clamp_min(0).flatten(1)).view_as(edges)
    return torch.where(edges == NO_NODE, NO_NODE, found)


def without(graphs: Graphs, gone: Tensor) -> Graphs:
    """The graphs with the slots `gone` (P, N) unused."""
    return Graphs(
        graphs.action.masked_fill(gone, NO_NODE),
        graphs.edges.masked_fill(gone[..., None], NO_NODE),
        graphs.parameters.masked_fill(gone[..., None], 0),
        graphs.start,
    )


def narrowed(graphs: Graphs, nodes: int) -> Graphs:
    """The same graphs with only their first `nodes` slots, which must contain all nodes."""
    g = graphs
    return Graphs(g.action[:, :nodes], g.edges[:, :nodes], g.parameters[:, :nodes], g.start)


def trimmed(graphs: Graphs) -> Graphs:
    """The same graphs, compacted, with only as many slots as the largest needs."""
    nodes = int(graphs.num_nodes.max()) if len(graphs) else 1
    return Graphs(*(x.contiguous() for x in vars(narrowed(compacted(graphs), nodes)).values()))


def widened(graphs: Graphs, nodes: int) -> Graphs:
    """The same graphs with unused slots at their end, `nodes` in all."""
    more = nodes - graphs.capacity
    if more == 0:
        return graphs
    return Graphs(
        pad(graphs.action, (0, more), value=NO_NODE),
        pad(graphs.edges, (0, 0, 0, more), value=NO_NODE),
        pad(graphs.parameters, (0, 0, 0, more)),
        graphs.start,
    )


def reachable(graphs: Graphs) -> Tensor:
    """(P, N) bool, the start and all slots that it leads to, by breadth-first search."""
    p, n, o = graphs.edges.shape
    seen = torch.zeros(p, n + 1, dtype=torch.bool, device=graphs.start.device)
    seen.scatter_(1, graphs.start[:, None], True)
    # Heads that are no node go to a dump slot at the end.
    heads = torch.where(graphs.edges == NO_NODE, n, graphs.edges)
    count = seen[:, :n].sum()
    while True:
        target = torch.where(seen[:, :n, None], heads, n).reshape(p, n * o)
        seen.scatter_(1, target, True)
        seen[:, n] = False
        new = seen.sum()
        if new == count:
            return seen[:, :n]
        count = new


def pruned(graphs: Graphs) -> Graphs:
    """The graphs without the nodes that the start does not lead to."""
    return without(graphs, ~reachable(graphs))


def valid(graphs: Graphs, actions: ActionSet) -> Tensor:
    """(P,) bool, whether each graph is valid."""
    n = graphs.capacity
    used, action, edges = graphs.used, graphs.action, graphs.edges
    known = ((action >= NO_NODE) & (action < len(actions))).all(1)
    start = graphs.start.clamp(0, n - 1)
    start_exists = (graphs.start == start) & used.gather(1, start[:, None])[:, 0]
    has_edge = actions.has_edge.to(action.device)[action.clamp(0, len(actions) - 1)]
    has_edge = has_edge & used[..., None]
    head = edges.clamp(0, n - 1)
    to_node = used.gather(1, head.flatten(1)).view_as(edges) & (edges == head)
    edges_right = torch.where(has_edge, to_node, edges == NO_NODE).flatten(1).all(1)
    ok = known & start_exists & edges_right
    safe = replace(graphs, start=start, edges=torch.where(to_node, edges, NO_NODE))
    return ok & (reachable(safe) == used).all(1)


def check_graph(graphs: Graphs, actions: ActionSet, names: Sequence[str] | None = None) -> None:
    """A GraphError that names the node and the fault, unless the first graph is valid.

    Messages contain the `names` of its N slots, by default their numbers.
    """
    action, edges = graphs.action[0].tolist(), graphs.edges[0].tolist()
    name = [repr(n) for n in names] if names else [str(i) for i in range(len(action))]
    start = int(graphs.start[0])
    nodes = {i for i, a in enumerate(action) if a != NO_NODE}
    if start not in nodes:
        raise GraphError(f"start node {start} does not exist; nodes are {sorted(nodes)}")
    for i in range(len(action)):
        if not NO_NODE <= action[i] < len(actions):
            raise GraphError(f"node {name[i]} has action {action[i]}; the set has {len(actions)}")
        module = actions.actions[action[i]] if action[i] != NO_NODE else None
        for j, head in enumerate(edges[i]):
            outcome = module.outcomes[j] if module and j < len(module.outcomes) else None
            leads = module is not None and outcome is not None and outcome not in module.terminal
            if leads and head not in nodes:
                raise GraphError(
                    f"node {name[i]} ({actions.names[action[i]]}) has no edge for outcome "
                    f"{outcome!r} (head {head}); every non-terminal outcome must lead to a node"
                )
            if not leads and head != NO_NODE:
                raise GraphError(
                    f"node {name[i]} has an edge to {head} for outcome {outcome or j!r}, which is "
                    "terminal or does not exist; remove the edge"
                )
    if not torch.isfinite(graphs.parameters[0]).all():
        node = int((~torch.isfinite(graphs.parameters[0])).any(1).nonzero()[0])
        raise GraphError(f"node {name[node]} has parameters that are not finite; give numbers")
    reached = reachable(graphs[:1])[0].tolist()
    if lost := [i for i in sorted(nodes) if not reached[i]]:
        raise GraphError(
            f"node {name[lost[0]]} cannot be reached from the start; remove or connect it"
        )
