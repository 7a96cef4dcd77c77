"""A skill as text: a skill file, or a drawing for Graphviz, GraphML readers or Markdown pages."""

import json
from typing import Any
from xml.sax.saxutils import escape

import jinja2

from cgtorch.graphs import Skill, skill_to_dict
from cgtorch.graphs.clusters import clusters_of
from cgtorch.graphs.skill import a_skill
from cgtorch.ground.errors import printable


def to_json(skill: Skill) -> bytes:
    """The same as `cgtorch.graphs.save_skill` writes and `load_skill` reads."""
    return json.dumps(skill_to_dict(a_skill(skill)), indent=1).encode() + b"\n"


def to_dot(skill: Skill) -> bytes:
    """The skill in the DOT language, as in the paper: start nodes red and square.

    Every skill in it is a cluster, which nodes that run it point to with a dashed line.
    """
    return _drawing("skill.dot.jinja", skill)


def to_graphml(skill: Skill) -> bytes:
    """The skill for yEd, Gephi, networkx and the like, with nested graphs for the skills in it.

    Nodes have a label, the action, its parameters (numbers separated by spaces), whether they are a
    start node, and, for ends, whether the skill has succeeded. Edges have an outcome. An edge from
    a node to the group of the skill that it runs has `runs` instead.
    """
    return _drawing("skill.graphml.jinja", skill)


def to_mermaid(skill: Skill) -> bytes:
    """The skill as a flowchart; start nodes are red, and sub-skills have double vertical edges.

    Every skill in it is a subgraph, and nodes that run it point to it with a dotted line.
    """
    return _drawing("skill.mermaid.jinja", skill)


def filled(template: str, **values: Any) -> bytes:
    """A filled template of this package; names are quoted by `dot`, `mermaid` or `xml`."""
    environment = jinja2.Environment(  # noqa: S701  it is no HTML
        loader=jinja2.PackageLoader("cgtorch.export"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"dot": _dot, "mermaid": _mermaid, "xml": _xml, "literal": ascii}
    return environment.get_template(template).render(values).encode()


def _drawing(template: str, skill: Skill) -> bytes:
    clusters = clusters_of(a_skill(skill))
    starts = {cluster.key: cluster.start for cluster in clusters}
    callers = [node for cluster in clusters for node in cluster.nodes.values() if node.runs]
    return filled(template, skill=skill, clusters=clusters, starts=starts, callers=callers)


def _dot(text: str) -> str:
    """A quoted string; a backslash is doubled, as DOT has escapes that begin with it."""
    return '"' + printable(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _mermaid(text: str) -> str:
    """A quoted string; characters with a meaning in Mermaid or HTML become character codes."""
    return '"' + "".join(f"#{ord(c)};" if c in '"#&;<>\\`' else c for c in printable(text)) + '"'


def _xml(text: str) -> str:
    return escape(printable(text))
