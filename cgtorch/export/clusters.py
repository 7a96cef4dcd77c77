"""A skill as what is drawn of it: one cluster of nodes, edges and ends for every skill in it."""

from dataclasses import dataclass

from cgtorch.graphs import Skill, to_networkx


@dataclass(frozen=True)
class Node:
    """A node.

    Attributes:
        key: unique in the whole drawing; letters, digits and underscores.
        label: as in the paper, name_slot.
        action: name of its action or skill.
        parameters: of its action.
        runs: the key of the cluster that it runs if it is a skill.
    """

    key: str
    label: str
    action: str
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
        key: unique in the whole drawing.
        name: the skill's, see `numbered`.
        start: key of its start node.
        nodes: its nodes.
        ends: keys of its ends, and whether the skill then has succeeded.
        edges: by outcome, terminal outcomes to ends.
    """

    key: str
    name: str
    start: str
    nodes: tuple[Node, ...]
    ends: dict[str, bool]
    edges: tuple[Edge, ...]


def numbered(skill: Skill) -> list[tuple[str, Skill]]:
    """The skill and all skills in it, each once, the outermost first, with their names.

    A skill in another one has the name by which it is a node where it first is one.
    """
    found = [(skill.name, skill)]
    seen = {id(skill)}
    for _, outer in found:  # grows on the way
        for name, inner in outer.sub_skills.items():
            if id(inner) not in seen:
                seen.add(id(inner))
                found.append((name, inner))
    return found


def clusters_of(skill: Skill) -> list[Cluster]:
    """What `numbered` gives as clusters, in the same order."""
    skills = numbered(skill)
    place = {id(one): number for number, (_, one) in enumerate(skills)}
    return [_cluster(number, name, one, place) for number, (name, one) in enumerate(skills)]


def _cluster(number: int, name: str, skill: Skill, place: dict[int, int]) -> Cluster:
    view = to_networkx(skill.graph, skill.actions)
    key = {node: f"s{number}_n{node}" for node in view}
    runs = {inner: f"s{place[id(one)]}" for inner, one in skill.sub_skills.items()}
    nodes = tuple(
        Node(key[n], d["label"], d["action"], tuple(d["parameters"]), runs.get(d["action"]))
        for n, d in view.nodes(data=True)
    )
    edges = [Edge(key[a], key[b], d["outcome"]) for a, b, d in view.edges(data=True)]
    ends: dict[str, bool] = {}
    for node, data in view.nodes(data=True):
        action = skill.actions.actions[skill.actions.index(data["action"])]
        for outcome, success in action.terminal.items():
            end = f"s{number}_{'success' if success else 'failure'}"
            ends[end] = success
            edges.append(Edge(key[node], end, outcome))
    return Cluster(f"s{number}", name, key[view.graph["start"]], nodes, ends, tuple(edges))


def printable(text: str) -> str:
    """The text with what cannot be printed written out; names may come from anyone's file."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
