"""A skill as a drawing for Graphviz."""

from cgtorch.export.clusters import Cluster, clusters_of, printable
from cgtorch.graphs import Skill

START = 'shape=box, style=filled, fillcolor="#d62728", fontcolor=white'
SKILL = "shape=box, style=rounded, peripheries=2"
END = {True: "shape=doublecircle, color=green4", False: "shape=doublecircle, color=red4"}


def to_dot(skill: Skill) -> bytes:
    """The skill in the DOT language, as in the paper: start nodes red and square.

    Every skill in it is a cluster, which nodes that run it point to with a dashed line.
    """
    clusters = clusters_of(skill)
    lines = [f"digraph {_quoted(skill.name)} {{", "  compound=true;", "  node [shape=ellipse];"]
    for cluster in clusters:
        lines += _lines(cluster)
    start = {cluster.key: cluster.start for cluster in clusters}
    lines += [
        f"  {node.key} -> {start[node.runs]} [style=dashed, lhead=cluster_{node.runs}];"
        for cluster in clusters
        for node in cluster.nodes
        if node.runs is not None
    ]
    return ("\n".join(lines) + "\n}\n").encode()


def _lines(cluster: Cluster) -> list[str]:
    """One skill; nodes belong to the cluster that they are first named in."""
    lines = [f"  subgraph cluster_{cluster.key} {{", f"    label={_quoted(cluster.name)};"]
    for node in cluster.nodes:
        look = f", {START}" if node.key == cluster.start else f", {SKILL}" if node.runs else ""
        lines.append(f"    {node.key} [label={_quoted(node.label)}{look}];")
    for end, success in cluster.ends.items():
        lines.append(f'    {end} [label="{"success" if success else "failure"}", {END[success]}];')
    lines += [f"    {e.tail} -> {e.head} [label={_quoted(e.outcome)}];" for e in cluster.edges]
    return [*lines, "  }"]


def _quoted(text: str) -> str:
    r"""A quoted string; a backslash is doubled, as DOT has escapes such as \N in labels."""
    return '"' + printable(text).replace("\\", "\\\\").replace('"', '\\"') + '"'
