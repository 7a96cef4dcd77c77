"""A skill as text: a skill file, or a drawing for Graphviz, GraphML readers or Markdown pages."""

import json
from typing import Any
from xml.sax.saxutils import escape

import jinja2

from cgtorch.graphs import Skill, skill_to_dict
from cgtorch.graphs.clusters import clusters_of
from cgtorch.ground.errors import printable


def to_json(skill: Skill) -> bytes:
    """The same as `cgtorch.graphs.save_skill` writes and `load_skill` reads."""
    return json.dumps(skill_to_dict(skill), indent=1, allow_nan=False).encode() + b"\n"


def to_dot(skill: Skill) -> bytes:
    """The skill in the DOT language, as in the paper: start nodes red and square.

    Every skill in it is a cluster, which nodes that run it point to with a dashed line.
    """
    return _drawing("skill.dot.jinja", skill)


def to_graphml(skill: Skill) -> bytes:
    """The skill for yEd, Gephi, networkx and the like: a graph in it for every skill in it.

    Nodes have a label, the action, its parameters (numbers with spaces between them), whether they
    are a start node and, ends only, whether the skill has succeeded. Edges have an outcome; one
    from a node to the group of the skill that it runs says `runs` instead.
    """
    return _drawing("skill.graphml.jinja", skill)


def to_mermaid(skill: Skill) -> bytes:
    """The skill as a flowchart; start nodes red, nodes that are skills with two bars at the sides.

    Every skill in it is a subgraph, which nodes that run it point to with a dotted line.
    """
    return _drawing("skill.mermaid.jinja", skill)


def filled(template: str, **values: Any) -> bytes:
    """A template of this folder, filled in; its names are quoted by `dot`, `mermaid`, `xml`."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cgtorch.export"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701  it is no HTML
    )
    environment.filters |= {"dot": _dot, "mermaid": _mermaid, "xml": _xml, "literal": ascii}
    return environment.get_template(template).render(values).encode()


def _drawing(template: str, skill: Skill) -> bytes:
    clusters = clusters_of(skill)
    starts = {cluster.key: cluster.start for cluster in clusters}
    callers = [node for cluster in clusters for node in cluster.nodes.values() if node.runs]
    return filled(template, skill=skill, clusters=clusters, starts=starts, callers=callers)


def _dot(text: str) -> str:
    r"""A quoted string; a backslash is doubled, as DOT has escapes such as \N in labels."""
    return '"' + printable(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _mermaid(text: str) -> str:
    """A quoted string; what Mermaid or HTML would read as more than text is written as a code."""
    return '"' + "".join(f"#{ord(c)};" if c in '"#&;<>\\`' else c for c in printable(text)) + '"'


def _xml(text: str) -> str:
    return escape(printable(text))
