"""Computational graphs as a dataclass of tensors (section IV-A)."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.errors import GraphError

NO_NODE = -1


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Graphs:
    """P computational graphs of up to N nodes.

    A node is a slot, and unused slots may be anywhere. A node has one edge per outcome, each with
    its own head, so there can be parallel edges.

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

    def taken(x: Tensor) -> Tensor:
        """Rows of x (P, N, ...) in the new order."""
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
