"""A skill made by hand."""

import networkx as nx

from cgtorch.graphs import Skill, from_networkx
from cgtorch.graphs.view import View
from cgtorch.tabletop.actions import paper_actions


def nearly(ahead: float) -> Skill:
    """Drives ahead (m) and grasps, over and over."""
    actions = paper_actions()
    view: View = nx.MultiDiGraph(start=0)
    view.add_node(0, action="ContinuousNN", parameters=[0.0] * 33 + [ahead, 0.0, 0.0])
    view.add_node(1, action="MoveBase", parameters=[])
    view.add_node(2, action="Grasp", parameters=[])
    view.add_edge(0, 1, outcome="success")
    view.add_edge(1, 2, outcome="success")
    view.add_edge(1, 0, outcome="failure")
    view.add_edge(2, 0, outcome="failure")
    return Skill(f"ahead {ahead}", from_networkx(view, actions), actions, 6)
