"""A picture of a skill's computational graph, with a panel for every skill in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from cgtorch.graphs import (
    Action,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    Perceive,
    RecurrentNN,
    Skill,
    Step,
    Test,
)
from cgtorch.graphs.clusters import Cluster, Edge, Node, clusters_of
from cgtorch.graphs.skill import a_skill
from cgtorch.ground.errors import printable
from cgtorch.report.layout import Box, Placement, Point, Route, pieces, place

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NODE_TEXT, LABEL_TEXT, TITLE_TEXT = 9.0, 7.5, 9.5
MARGIN, PADDING, TITLE = 0.12, 0.18, 0.22
LINE, BACK, FAINT, INK = "#555555", "#8a6d3b", "#d0d4d9", "#1c1f24"
START, END_GOOD, END_BAD = "#d62728", "#1a7f37", "#8c2f39"
COLOURS: dict[type[Action], str] = {
    Step: "#bcdcf5",
    Perceive: "#cfeede",
    Test: "#fbdca6",
    BranchingNN: "#f6cadd",
    ContinuousNN: "#dcd0f2",
    DelayNN: "#dcd0f2",
    RecurrentNN: "#dcd0f2",
}
"""Colours of actions by their kind; all others take turns."""
OTHERS = ("#e6e6b8", "#c9e3e6", "#ead3c0", "#d5dbe3")
SKILL_FILL, SKILL_RIM = "#ffffff", "#3b4a6b"


@dataclass(frozen=True)
class Panel:
    """The layout of one skill of the picture; sizes in inches, including the frame."""

    cluster: Cluster
    title: str
    placement: Placement
    width: float
    height: float


def draw_skill(skill: Skill) -> "Figure":
    """The skill as in the paper's figures: red square start node, edges labelled by outcome.

    Nodes are coloured by action. Sub-skills have a double rim and a panel below. A terminal outcome
    ends in a small named mark; edges that lead back up are brown. Artists of nodes, edges and ends
    have a gid: "node:", "edge:" or "end:", the path, then their key.
    """
    return draw_clusters(clusters_of(a_skill(skill)))


def draw_clusters(clusters: Sequence[Cluster]) -> "Figure":
    """The panels of some clusters of a skill."""
    from matplotlib.figure import Figure

    panels = [_panel(cluster) for cluster in clusters]
    corners, width, height = packed([(panel.width, panel.height) for panel in panels])
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.axis("off")
    for panel, corner in zip(panels, corners, strict=True):
        _draw(axes, panel, corner)
    return figure


def gid_of(cluster: Cluster, part: Node | Edge) -> str:
    """The gid of a node, an edge or an end in these pictures."""
    if isinstance(part, Node):
        return f"node:{cluster.path}:{printable(part.label)}"
    words = [cluster.path, printable(cluster.nodes[part.tail].label), part.outcome]
    if part.head in cluster.ends:
        return ":".join(["end", *words])
    return ":".join(["edge", *words, printable(cluster.nodes[part.head].label)])


def _panel(cluster: Cluster) -> Panel:
    nodes, edges = cluster.nodes, cluster.edges
    title = f"{cluster.path} · {len(nodes)} node{'s' if len(nodes) != 1 else ''}"
    widths = {n: text_width(printable(node.label), NODE_TEXT) + 0.24 for n, node in nodes.items()}
    outcome_widths = [text_width(edge.outcome, LABEL_TEXT) for edge in edges]
    placement = place(widths, cluster.start, edges, outcome_widths)
    width = max(placement.width, text_width(title, TITLE_TEXT, bold=True) + 0.1) + 2 * PADDING
    return Panel(cluster, title, placement, width, placement.height + TITLE + 2 * PADDING)


@cache
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width in inches of one line of text in the default font, `size` in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(weight="bold" if bold else "normal", size=size)
    # Not as mathematics, which a "$" in a name would be.
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0]) / 72


def packed(sizes: Sequence[Point]) -> tuple[list[Point], float, float]:
    """Top left corners of panels, and the width and height of a compact picture of them.

    It is at most 1.8 times as wide as a square with the area of all panels and their margins, and
    two margins, unless one panel is wider.
    """
    area = sum((w + MARGIN) * (h + MARGIN) for w, h in sizes)
    widest = max(w for w, _ in sizes)
    tries = [_shelves(sizes, max(factor * area**0.5, widest) + 2 * MARGIN)
             for factor in (0.8, 1.0, 1.2, 1.4, 1.6, 1.8)]  # fmt: skip
    return min(tries, key=lambda found: found[1] * found[2] * max(found[2] / found[1], 1) ** 0.5)


def _shelves(sizes: Sequence[Point], limit: float) -> tuple[list[Point], float, float]:
    """The same within a maximum width: shelves of columns, the first panel first, then by size."""
    corners = [(0.0, 0.0)] * len(sizes)
    x = top = y = MARGIN  # the column's left, the shelf's top, and how far the column is filled
    column = tallest = right = 0.0
    for i in [0, *sorted(range(1, len(sizes)), key=lambda i: -sizes[i][1])]:
        width, height = sizes[i]
        fits = y > top and y + height <= top + tallest and x + width + MARGIN <= limit
        if not fits and y > top:
            x, y, column = x + column + MARGIN, top, 0.0
            if x + width + MARGIN > limit:
                x, top, y, tallest = MARGIN, top + tallest + MARGIN, top + tallest + MARGIN, 0.0
        corners[i] = (x, y)
        y += height + MARGIN
        column, tallest = max(column, width), max(tallest, y - MARGIN - top)
        right = max(right, x + column + MARGIN)
    return corners, right, top + tallest + MARGIN


def _draw(axes: "Axes", panel: Panel, corner: Point) -> None:
    from matplotlib.patches import FancyBboxPatch

    x, y = corner
    frame = FancyBboxPatch(
        (x, y), panel.width, panel.height, boxstyle="round,pad=0,rounding_size=0.08",
        facecolor="#fbfbfc", edgecolor=FAINT, linewidth=0.8, zorder=0,
        gid=f"panel:{panel.cluster.path}",
    )  # fmt: skip
    axes.add_patch(frame)
    axes.text(
        x + PADDING, y + 0.12, panel.title, fontsize=TITLE_TEXT, weight="bold", color=INK,
        va="top", ha="left", parse_math=False,
    )  # fmt: skip
    origin = (x + (panel.width - panel.placement.width) / 2, y + TITLE + PADDING)
    for edge, route in zip(panel.cluster.edges, panel.placement.routes, strict=True):
        _draw_edge(axes, panel.cluster, edge, route, origin)
    for key, box in panel.placement.boxes.items():
        _draw_node(axes, panel.cluster, panel.cluster.nodes[key], box, origin)


def _draw_node(axes: "Axes", cluster: Cluster, node: Node, box: Box, origin: Point) -> None:
    from matplotlib.patches import FancyBboxPatch

    is_start = node.key == cluster.start
    index = cluster.skill.actions.index(node.name)
    action = cluster.skill.actions.actions[index]
    kinds = (colour for kind, colour in COLOURS.items() if isinstance(action, kind))
    fill, rim = next(kinds, OTHERS[index % len(OTHERS)]), LINE
    if is_start:
        fill, rim = START, INK
    elif node.runs:
        fill, rim = SKILL_FILL, SKILL_RIM
    shape = "square,pad=0" if is_start else "round,pad=0,rounding_size=0.1"
    x, y = origin[0] + box.x, origin[1] + box.y
    gid = gid_of(cluster, node)

    def add(inset: float, **style: Any) -> None:
        width, height = box.width - 2 * inset, box.height - 2 * inset
        at = (x - width / 2, y - height / 2)
        axes.add_patch(FancyBboxPatch(at, width, height, boxstyle=shape, **style))

    add(0, facecolor=fill, edgecolor=rim, linewidth=1.0, zorder=3, gid=gid)
    if node.runs:
        inner = "white" if is_start else rim
        add(0.035, facecolor="none", edgecolor=inner, linewidth=0.8, zorder=4)
    axes.text(
        x, y, printable(node.label), fontsize=NODE_TEXT, color="white" if is_start else INK,
        ha="center", va="center_baseline", zorder=5, gid=f"text:{gid}", parse_math=False,
    )  # fmt: skip


def _draw_edge(axes: "Axes", cluster: Cluster, edge: Edge, route: Route, origin: Point) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    points = [(origin[0] + x, origin[1] + y) for x, y in route.points]
    gid = gid_of(cluster, edge)
    colour = BACK if route.upward or route.loop else LINE
    style: dict[str, Any] = {"color": colour, "ha": "left"}
    if (success := cluster.ends.get(edge.head)) is not None:
        colour = END_GOOD if success else END_BAD
        mark = {"boxstyle": "round,pad=0.25,rounding_size=0.6", "fc": colour, "ec": "none"}
        style = {"color": "white", "ha": "center", "bbox": mark}
    vertices, codes = [points[0]], [Path.MOVETO]
    if route.loop:
        vertices += points[1:]
        codes += [Path.CURVE4] * 3
    else:
        for a, b, curved in pieces(points):
            half = (a[1] + b[1]) / 2
            vertices += [(a[0], half), (b[0], half), b] if curved else [b]
            codes += [Path.CURVE4] * 3 if curved else [Path.LINETO]
    arrow = FancyArrowPatch(
        path=Path(vertices, codes), arrowstyle="-|>", mutation_scale=8, linewidth=1.0,
        color=colour, shrinkA=0, shrinkB=0, zorder=2, gid=gid, joinstyle="round",
    )  # fmt: skip
    axes.add_patch(arrow)
    axes.text(
        origin[0] + route.label[0], origin[1] + route.label[1], edge.outcome, fontsize=LABEL_TEXT,
        va="center", zorder=4, gid=f"text:{gid}", parse_math=False, **style,
    )  # fmt: skip
