"""The validity of graphs, and pruning (section IV-B).

A graph is valid if its start exists, every non-terminal outcome of every node leads to a node, and
every node can be reached from the start.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs.action_set import ActionSet
from cgtorch.graphs.graphs import NO_NODE, Graphs, without
from cgtorch.ground.errors import GraphError


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
