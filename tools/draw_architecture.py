"""Draw the package's folders and the imports between them: docs/images/architecture.svg.

    python tools/draw_architecture.py

A folder is above all folders that it imports. Indirect arrows are left out, and so are those to
folders that almost all import.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import networkx as nx

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "cgtorch"
OUTPUT = ROOT / "docs" / "images" / "architecture.svg"
COMMON = ("ground",)
WIDTH, HEIGHT, GAP_X, GAP_Y, EDGE, LEAST = 112, 30, 40, 30, 16, 720
STYLE = """\
  <style>
    rect { fill: #eef1fb; stroke: #4051b5 }
    text { font: 14px sans-serif; fill: #1c1f24; text-anchor: middle }
    path { stroke: #6b7280; fill: none; marker-end: url(#head) }
  </style>
  <marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">
    <path d="M0 0L8 4L0 8z" style="fill: #6b7280; stroke: none; marker-end: none"/>
  </marker>
  <rect width="100%" height="100%" style="fill: #ffffff; stroke: none"/>"""  # noqa: E501


def imports() -> nx.DiGraph:
    """Which folder of the package imports which, type checkers' imports left out."""
    graph = nx.DiGraph()
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        folder = path.relative_to(PACKAGE).parts[0]
        graph.add_node(folder)
        for name in imported(ast.parse(path.read_text())):
            parts = name.split(".")
            known = parts[0] == PACKAGE.name and len(parts) > 1 and (PACKAGE / parts[1]).is_dir()
            if known and parts[1] != folder:
                graph.add_edge(folder, parts[1])
    return graph


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules that a file imports when it runs."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        yield from imported(node)


def drawing(graph: nx.DiGraph) -> str:
    """The SVG text; the same imports give the same text."""
    groups = nx.condensation(graph)  # folders that import each other share a level
    level = dict.fromkeys(groups, 0)
    for group in reversed(list(nx.topological_sort(groups))):
        level[group] = max((level[other] + 1 for other in groups.successors(group)), default=0)
    height = {name: level[group] for name, group in groups.graph["mapping"].items()}
    rows = [sorted(n for n in graph if height[n] == h) for h in range(max(height.values()), -1, -1)]
    rows = [part for row in rows if row for part in (row[i : i + 5] for i in range(0, len(row), 5))]
    widest = max(map(len, rows))
    full = max(LEAST, 2 * EDGE + 40 + widest * (WIDTH + GAP_X) - GAP_X)
    place = {}
    for r, row in enumerate(rows):
        begin = (full - len(row) * (WIDTH + GAP_X) + GAP_X) / 2 + (r % 2 - 0.5) * 80
        for i, name in enumerate(row):
            place[name] = begin + i * (WIDTH + GAP_X), EDGE + r * (HEIGHT + GAP_Y)
    shown = graph.copy()
    shown.remove_nodes_from(COMMON)
    if nx.is_directed_acyclic_graph(shown):
        shown = nx.transitive_reduction(shown)
    lines = [arrow(place[a], place[b]) for a, b in sorted(shown.edges)]
    boxes = [box(name, *place[name]) for name in sorted(place)]
    total = 2 * EDGE + len(rows) * (HEIGHT + GAP_Y) - GAP_Y
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {full} {total}" role="img">'
    title = "  <title>The folders of the package and the imports between them</title>"
    return "\n".join([head, title, STYLE, *lines, *boxes, "</svg>", ""])


def box(name: str, x: float, y: float) -> str:
    """A folder."""
    rect = f'<rect x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="5"/>'
    text = f'<text x="{x + WIDTH / 2:g}" y="{y + HEIGHT / 2 + 5:g}">{name}</text>'
    return f"  {rect}{text}"


def arrow(a: tuple[float, float], b: tuple[float, float]) -> str:
    """A line from one folder down to another, or sideways within a row."""
    (ax, ay), (bx, by) = (a[0] + WIDTH / 2, a[1]), (b[0] + WIDTH / 2, b[1])
    start, end = (ay + HEIGHT, by) if by > ay else (ay, by + HEIGHT)
    middle = (start + end) / 2
    return f'  <path d="M{ax:g} {start:g}C{ax:g} {middle:g} {bx:g} {middle:g} {bx:g} {end:g}"/>'


def main() -> None:
    """Write the drawing."""
    OUTPUT.write_text(drawing(imports()))


if __name__ == "__main__":
    main()
