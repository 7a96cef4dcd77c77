"""A graph as a networkx `MultiDiGraph`, to be drawn, stored, read and checked."""

from typing import TypeAlias

import networkx as nx
import torch

from cgtorch.actions import ActionSet
from cgtorch.errors import GraphError
from cgtorch.graphs.graphs import NO_NODE, Graphs

View: TypeAlias = "nx.MultiDiGraph[int | str]"


def to_networkx(graphs: Graphs, actions: ActionSet, index: int = 0) -> View:
    """One individual as a multigraph.

    Nodes are slots with attributes `action` (name), `label` (as in the paper: name_slot) and
    `parameters` (list of float); edges carry `outcome`; the graph carries `start`.
    """
    view: View = nx.MultiDiGraph(start=int(graphs.start[index]))
    action = graphs.action[index].tolist()
    slots = [i for i, a in enumerate(action) if a != NO_NODE]
    for i in slots:
        name, k = actions.names[action[i]], int(actions.num_parameters[action[i]])
        values = graphs.parameters[index, i, :k].tolist()
        view.add_node(i, action=name, label=f"{name}_{i}", parameters=values)
    for i in slots:
        for j, outcome in enumerate(actions.actions[action[i]].outcomes):
            if (head := int(graphs.edges[index, i, j])) != NO_NODE:
                view.add_edge(i, head, key=outcome, outcome=outcome)
    return view


def from_networkx(view: View, actions: ActionSet, capacity: int | None = None) -> Graphs:
    """One graph (P = 1) from a multigraph with the attributes that `to_networkx` gives.

    Raises:
        GraphError: a node or edge lacks an attribute, names an unknown outcome, has the wrong
            number of parameters, or an outcome has two edges.
    """
    nodes = list(view.nodes)
    n = max(capacity or 0, len(nodes), 1)
    slot = {node: i for i, node in enumerate(nodes)}
    action = torch.full((1, n), NO_NODE)
    edges = torch.full((1, n, actions.outcome_capacity), NO_NODE)
    parameters = torch.zeros(1, n, actions.parameter_capacity)
    for node, data in view.nodes(data=True):
        a = actions.index(data["action"])
        values, wanted = data.get("parameters", []), int(actions.num_parameters[a])
        if len(values) != wanted:
            raise GraphError(
                f"node {node!r} ({data['action']}) has {len(values)} parameters; give {wanted}"
            )
        action[0, slot[node]] = a
        parameters[0, slot[node], :wanted] = torch.tensor(values)
    for tail, head, data in view.edges(data=True):
        outcomes = actions.actions[int(action[0, slot[tail]])].outcomes
        if data["outcome"] not in outcomes:
            raise GraphError(
                f"edge {tail!r} → {head!r} has outcome {data['outcome']!r}; known are {outcomes}"
            )
        where = (0, slot[tail], outcomes.index(data["outcome"]))
        if edges[where] != NO_NODE:
            raise GraphError(f"node {tail!r} has two edges for outcome {data['outcome']!r}")
        edges[where] = slot[head]
    if view.graph.get("start") not in slot:
        raise GraphError(f"start node {view.graph.get('start')!r} is none of the nodes")
    return Graphs(action, edges, parameters, torch.tensor([slot[view.graph["start"]]]))
