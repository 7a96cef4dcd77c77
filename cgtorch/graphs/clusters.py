"""The structure of a skill for drawings and state machines: a cluster for every skill in it."""

from dataclasses import dataclass

from cgtorch.graphs.action import Action
from cgtorch.graphs.skill import Skill
from cgtorch.graphs.view import to_networkx
from cgtorch.ground.errors import printable


@dataclass(frozen=True)
class Node:
    """A node, whose action or skill is called `name`.

    Attributes:
        key: A key that is unique in the whole drawing; letters, digits and underscores.
        label: Name and slot, as in the paper: name_slot.
        runs: The key of the cluster that it runs, if it is a skill.
    """

    key: str
    label: str
    name: str
    action: Action
    parameters: tuple[float, ...]
    runs: str | None


@dataclass(frozen=True)
class Edge:
    """An edge from node `tail` to node or end `head`, by their keys."""

    tail: str
    head: str
    outcome: str


@dataclass(frozen=True)
class Cluster:
    """One skill.

    Attributes:
        key: A key that is unique in the whole drawing.
        names: The names of the nodes that lead to it from the outermost skill, and its own.
        start: The key of its start node.
        nodes: Its nodes by key, in the order of their slots.
        ends: The keys of its ends, and whether the skill then has succeeded.
        edges: Edges by outcome; terminal outcomes lead to ends.
    """

    key: str
    names: tuple[str, ...]
    skill: Skill
    start: str
    nodes: dict[str, Node]
    ends: dict[str, bool]
    edges: tuple[Edge, ...]

    @property
    def name(self) -> str:
        """The name of its first node, or the outermost skill's own name."""
        return self.names[-1]

    @property
    def path(self) -> str:
        """All names that lead to it, as printable text."""
        return " › ".join(map(printable, self.names))


def clusters_of(skill: Skill) -> list[Cluster]:
    """The skill and all skills in it, each once, level by level from the outermost."""
    found: list[tuple[tuple[str, ...], Skill]] = [((skill.name,), skill)]
    number = {id(skill): 0}
    for names, outer in found:  # grows on the way
        for name, inner in outer.sub_skills.items():
            if id(inner) not in number:
                number[id(inner)] = len(found)
                found.append(((*names, name), inner))
    return [_cluster(i, names, one, number) for i, (names, one) in enumerate(found)]


def _cluster(i: int, names: tuple[str, ...], skill: Skill, number: dict[int, int]) -> Cluster:
    view = to_networkx(skill.graph, skill.actions)
    key = {slot: f"s{i}_n{slot}" for slot in view}
    runs = {inner: f"s{number[id(one)]}" for inner, one in skill.sub_skills.items()}
    nodes, ends = dict[str, Node](), dict[str, bool]()
    edges = [Edge(key[a], key[b], data["outcome"]) for a, b, data in view.edges(data=True)]
    for slot, data in view.nodes(data=True):
        name = data["action"]
        action = skill.actions.actions[skill.actions.index(name)]
        about = data["label"], name, action, tuple(data["parameters"]), runs.get(name)
        nodes[key[slot]] = Node(key[slot], *about)
        for outcome, success in action.terminal.items():
            end = f"s{i}_{'success' if success else 'failure'}"
            ends[end] = success
            edges.append(Edge(key[slot], end, outcome))
    return Cluster(f"s{i}", names, skill, key[view.graph["start"]], nodes, ends, tuple(edges))
