"""A skill as a Mermaid flowchart, which Markdown pages show as a drawing."""

from cgtorch.export.clusters import clusters_of, printable
from cgtorch.graphs import Skill

STYLES = """\
  classDef start fill:#d62728,color:#ffffff,stroke:#1c1f24
  classDef success fill:#1a7f37,color:#ffffff,stroke:none
  classDef failure fill:#8c2f39,color:#ffffff,stroke:none
"""


def to_mermaid(skill: Skill) -> bytes:
    """The skill as a flowchart; start nodes red, nodes that are skills with two bars at the sides.

    Every skill in it is a subgraph, which nodes that run it point to with a dotted line.
    """
    clusters = clusters_of(skill)
    lines = ["flowchart TD"]
    for cluster in clusters:
        lines.append(f"  subgraph {cluster.key}[{_quoted(cluster.name)}]")
        for node in cluster.nodes:
            opening, closing = ("[[", "]]") if node.runs else ("[", "]")
            kind = ":::start" if node.key == cluster.start else ""
            lines.append(f"    {node.key}{opening}{_quoted(node.label)}{closing}{kind}")
        for end, success in cluster.ends.items():
            word = "success" if success else "failure"
            lines.append(f'    {end}(["{word}"]):::{word}')
        lines += [f"    {e.tail} -->|{_quoted(e.outcome)}| {e.head}" for e in cluster.edges]
        lines.append("  end")
    lines += [f"  {node.key} -.-> {node.runs}"
              for cluster in clusters for node in cluster.nodes if node.runs]  # fmt: skip
    return ("\n".join(lines) + "\n" + STYLES).encode()


def _quoted(text: str) -> str:
    """A quoted string; what Mermaid or HTML would read as more than text is written as a code."""
    return '"' + "".join(f"#{ord(c)};" if c in '"#&;<>\\`' else c for c in printable(text)) + '"'
