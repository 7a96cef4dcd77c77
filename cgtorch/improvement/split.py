"""Doubling a node behind a branch, so that each copy learns a part of what the node did.

Both copies begin with the node's parameters, so that the graph does what it did (as in Chen et al.,
"Net2Net: accelerating learning via knowledge transfer", ICLR 2016).
"""

import torch

from cgtorch.evolution.lineages import tunable
from cgtorch.graphs import ActionSet, BranchingNN, Graphs, compacted, resized


def split(graph: Graphs, actions: ActionSet) -> Graphs | None:
    """A single graph whose only node with parameters is doubled behind a branch.

    None if there are several such nodes or none, or if no action branches.
    """
    chooser = next((i for i, a in enumerate(actions.actions) if isinstance(a, BranchingNN)), None)
    graph = compacted(graph)
    found = tunable(graph, actions).any(1).nonzero().flatten().tolist()
    if chooser is None or len(found) != 1:
        return None
    node, branch, copy = found[0], graph.capacity, graph.capacity + 1
    sizes = max(graph.edges.shape[2], 2), int(max(actions.num_parameters))
    wide = resized(graph, graph.capacity + 2, *sizes)
    edges = torch.where(wide.edges == node, branch, wide.edges)
    edges[0, copy] = edges[0, node]
    edges[0, branch, :2] = torch.tensor([node, copy])
    action, parameters = wide.action.clone(), wide.parameters.clone()
    action[0, branch], action[0, copy] = chooser, action[0, node]
    parameters[0, copy] = parameters[0, node]
    start = torch.where(wide.start == node, branch, wide.start)
    return Graphs(action, edges, parameters, start)
