"""A skill as GraphML, for yEd, Gephi, networkx and the like."""

from xml.etree import ElementTree

from cgtorch.export.clusters import Cluster, clusters_of, printable
from cgtorch.graphs import Skill

NAMESPACE = "http://graphml.graphdrawing.org/xmlns"
NODE = {"label": "string", "action": "string", "parameters": "string", "start": "boolean",
        "success": "boolean"}  # fmt: skip
EDGE = {"outcome": "string", "runs": "boolean"}


def to_graphml(skill: Skill) -> bytes:
    """The skill as one directed graph with a nested graph for every skill in it.

    Nodes have a label, the action, its parameters (numbers with spaces between them), whether they
    are a start node and, ends only, whether the skill has succeeded. Edges have an outcome; one
    from a node to the group of the skill that it runs says `runs` instead.
    """
    clusters = clusters_of(skill)
    root = ElementTree.Element("graphml", xmlns=NAMESPACE)
    for what, keys in (("node", NODE), ("edge", EDGE)):
        for name, kind in keys.items():
            key = {"id": name, "for": what, "attr.name": name, "attr.type": kind}
            ElementTree.SubElement(root, "key", key)
    graph = ElementTree.SubElement(root, "graph", id="skill", edgedefault="directed")
    for cluster in clusters:
        _add(graph, cluster)
    for cluster in clusters:
        for node in cluster.nodes:
            if node.runs is not None:
                _element(graph, "edge", {"source": node.key, "target": node.runs}, runs="true")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _add(graph: ElementTree.Element, cluster: Cluster) -> None:
    """One skill as a node with a graph in it; yEd and networkx look for its folder type."""
    group = {"id": cluster.key, "yfiles.foldertype": "group"}
    inner = ElementTree.SubElement(
        _element(graph, "node", group, label=cluster.name),
        "graph",
        id=f"{cluster.key}_graph",
        edgedefault="directed",
    )
    for node in cluster.nodes:
        data = {"label": node.label, "action": node.action}
        data["parameters"] = " ".join(map(repr, node.parameters))
        data["start"] = str(node.key == cluster.start).lower()
        _element(inner, "node", {"id": node.key}, **data)
    for end, success in cluster.ends.items():
        word = "success" if success else "failure"
        _element(inner, "node", {"id": end}, label=word, success=str(success).lower())
    for edge in cluster.edges:
        ends = {"source": edge.tail, "target": edge.head}
        _element(inner, "edge", ends, outcome=edge.outcome)


def _element(
    parent: ElementTree.Element, tag: str, attributes: dict[str, str], **data: str
) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, tag, attributes)
    for key, value in data.items():
        ElementTree.SubElement(element, "data", key=key).text = printable(value)
    return element
