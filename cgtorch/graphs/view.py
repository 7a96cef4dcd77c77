"""A graph as a networkx `MultiDiGraph`, for drawing, storing, reading and checking."""

from collections.abc import Sequence
from numbers import Real
from typing import Any, TypeAlias

import networkx as nx
import torch
from torch import Tensor

from cgtorch.graphs.action_set import ActionSet
from cgtorch.graphs.graphs import NO_NODE, Graphs
from cgtorch.ground.errors import GraphError

View: TypeAlias = "nx.MultiDiGraph[int | str]"

FLOAT32_MAX = torch.finfo(torch.float32).max


def to_networkx(graphs: Graphs, actions: ActionSet, index: int = 0) -> View:
    """One individual as a multigraph, whose attribute `start` is its start node.

    Nodes are slots with attributes `action` (name), `label` (as in the paper: name_slot) and
    `parameters` (list of float); edges have `outcome`.
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
    """One graph (P = 1) from a multigraph with the attributes of `to_networkx`.

    Raises:
        GraphError: A node or edge lacks an attribute, names an unknown outcome, or has a wrong
            number of parameters or one that is not finite; an outcome has two edges; or an outcome
            that ends the skill has one.
        ActionError: A node has an unknown action.
    """
    nodes = list(view.nodes)
    n = max(capacity or 0, len(nodes), 1)
    slot = {node: i for i, node in enumerate(nodes)}
    action = torch.full((1, n), NO_NODE)
    edges = torch.full((1, n, actions.outcome_capacity), NO_NODE)
    parameters = torch.zeros(1, n, actions.parameter_capacity)
    for node, data in view.nodes(data=True):
        if "action" not in data:
            raise GraphError(f"node {node!r} has no action; give it one or add it as a node")
        a = actions.index(data["action"])
        wanted = int(actions.num_parameters[a])
        action[0, slot[node]] = a
        parameters[0, slot[node], :wanted] = _parameters(
            f"node {node!r} ({data['action']})", data.get("parameters", []), wanted
        )
    for tail, head, data in view.edges(data=True):
        edge, outcome = f"edge {tail!r} → {head!r}", data.get("outcome")
        module = actions.actions[int(action[0, slot[tail]])]
        if outcome not in module.outcomes:
            raise GraphError(f"{edge} has outcome {outcome!r}; known are {module.outcomes}")
        if outcome in module.terminal:
            raise GraphError(f"{edge} has outcome {outcome!r}, which ends the skill; remove it")
        where = (0, slot[tail], module.outcomes.index(outcome))
        if edges[where] != NO_NODE:
            raise GraphError(f"node {tail!r} has two edges for outcome {outcome!r}; keep one")
        edges[where] = slot[head]
    if view.graph.get("start") not in slot:
        raise GraphError(f"start node {view.graph.get('start')!r} is none of the nodes; name one")
    return Graphs(action, edges, parameters, torch.tensor([slot[view.graph["start"]]]))


def _parameters(node: str, values: Sequence[Any], wanted: int) -> Tensor:
    """The parameters of a node (wanted,), after checking that they are finite and as many."""
    if len(values) != wanted:
        raise GraphError(f"{node} has {len(values)} parameters; give {wanted}")
    for value in values:
        real = isinstance(value, Real) and not isinstance(value, bool)
        if not real or not abs(value) <= FLOAT32_MAX:  # NaN compares as False
            raise GraphError(f"{node} has parameter {value!r:.60}; give finite float32 numbers")
    return torch.tensor([float(value) for value in values])
