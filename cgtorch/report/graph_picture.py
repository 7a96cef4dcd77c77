"""A picture of a skill's computational graph, with a panel for every skill in it."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cgtorch.graphs import Skill, SubSkill, to_networkx
from cgtorch.ground.errors import printable
from cgtorch.report.layers import Link
from cgtorch.report.placing import Box, Placement, Point, Route, pieces, place
from cgtorch.report.text_size import text_width

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NODE_TEXT, LABEL_TEXT, TITLE_TEXT = 9.0, 7.5, 9.5
MARGIN, PADDING, TITLE = 0.12, 0.18, 0.22
LINE, BACK, FAINT, INK = "#555555", "#8a6d3b", "#d0d4d9", "#1c1f24"
START, END_GOOD, END_BAD = "#d62728", "#1a7f37", "#8c2f39"
COLOURS = {
    "MoveBase": "#bcdcf5",
    "Detect": "#cfeede",
    "Grasp": "#fbdca6",
    "ContinuousNN": "#dcd0f2",
    "EdgeNN": "#dcd0f2",
    "BranchingNN": "#f6cadd",
    "EdgeBranchingNN": "#f6cadd",
}
OTHERS = ("#e6e6b8", "#c9e3e6", "#ead3c0", "#d5dbe3")
SKILL_FILL, SKILL_RIM = "#ffffff", "#3b4a6b"


@dataclass(frozen=True)
class Panel:
    """One skill of the picture, laid out."""

    skill: Skill
    path: str
    title: str
    labels: dict[Hashable, str]
    kinds: dict[Hashable, str]
    start: Hashable
    links: list[Link]
    placement: Placement

    @property
    def width(self) -> float:
        """Inches, frame included."""
        return (
            max(self.placement.width, text_width(self.title, TITLE_TEXT, True) + 0.1) + 2 * PADDING
        )

    @property
    def height(self) -> float:
        """Inches, frame included."""
        return self.placement.height + TITLE + 2 * PADDING


def draw_skill(skill: Skill) -> "Figure":
    """The skill as in the paper's figures: start node red and square, edges labelled by outcome.

    Nodes are coloured by action, skills within the skill have a double rim and a panel of their
    own below. A terminal outcome ends in a small mark with its name. Edges that lead back up are
    brown. Every artist that stands for something has a gid: "node:", "edge:" or "end:" and
    the skill's name, then the node, edge or end.
    """
    return _drawn([_panel(s, path) for s, path in skills_of(skill)])


def draw_level(skill: Skill, path: str) -> "Figure":
    """One panel of that picture, of a skill without those in it.

    Args:
        skill: the skill.
        path: the names on the way to it, as `skills_of` tells them.
    """
    return _drawn([_panel(skill, path)])


def _drawn(panels: list[Panel]) -> "Figure":
    from matplotlib.figure import Figure

    corners, width, height = _packed(panels)
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.axis("off")
    for panel, corner in zip(panels, corners, strict=True):
        _draw(axes, panel, corner)
    return figure


def skills_of(skill: Skill) -> list[tuple[Skill, str]]:
    """The skill and all skills in it, each once, by level; with the names on the way to it."""
    found = [(skill, printable(skill.name))]
    seen = {id(skill)}
    for outer, path in found:  # grows on the way
        for name, inner in outer.sub_skills.items():
            if id(inner) not in seen:
                seen.add(id(inner))
                found.append((inner, f"{path} › {printable(name)}"))
    return found


def _panel(skill: Skill, path: str) -> Panel:
    view = to_networkx(skill.graph, skill.actions)
    labels: dict[Hashable, str] = {n: printable(d["label"]) for n, d in view.nodes(data=True)}
    kinds: dict[Hashable, str] = {n: d["action"] for n, d in view.nodes(data=True)}
    links = [Link(a, b, d["outcome"]) for a, b, d in view.edges(data=True)]
    for node, kind in kinds.items():
        action = skill.actions.actions[skill.actions.index(kind)]
        links += [Link(node, None, outcome) for outcome in action.outcomes
                  if outcome in action.terminal]  # fmt: skip
    widths = {n: text_width(s, NODE_TEXT) + 0.24 for n, s in labels.items()}
    outcome_widths = [text_width(e.outcome, LABEL_TEXT) for e in links]
    count = f"{skill.num_nodes} node{'s' if skill.num_nodes != 1 else ''}"
    start: Hashable = view.graph["start"]
    return Panel(
        skill,
        path,
        f"{path} · {count}",
        labels,
        kinds,
        start,
        links,
        place(widths, start, links, outcome_widths),
    )


def _packed(panels: list[Panel]) -> tuple[list[Point], float, float]:
    """Top left corners of the panels, and the picture's width and height: small, not too narrow."""
    sizes = [(p.width, p.height) for p in panels]
    area = sum((w + MARGIN) * (h + MARGIN) for w, h in sizes)
    widest = max(w for w, _ in sizes)
    tries = [_shelves(sizes, max(factor * area**0.5, widest) + 2 * MARGIN)
             for factor in (0.8, 1.0, 1.2, 1.4, 1.6, 1.8)]  # fmt: skip
    return min(tries, key=lambda found: found[1] * found[2] * max(found[2] / found[1], 1) ** 0.5)


def _shelves(sizes: list[tuple[float, float]], limit: float) -> tuple[list[Point], float, float]:
    """The same for a greatest width: shelves of columns, the first panel first, then by height."""
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
        facecolor="#fbfbfc", edgecolor=FAINT, linewidth=0.8, zorder=0, gid=f"panel:{panel.path}",
    )  # fmt: skip
    axes.add_patch(frame)
    axes.text(
        x + PADDING, y + 0.12, panel.title, fontsize=TITLE_TEXT, weight="bold", color=INK,
        va="top", ha="left", parse_math=False,
    )  # fmt: skip
    origin = (x + (panel.width - panel.placement.width) / 2, y + TITLE + PADDING)
    for link, route in zip(panel.links, panel.placement.routes, strict=True):
        _draw_link(axes, panel, link, route, origin)
    for node, box in panel.placement.boxes.items():
        _draw_node(axes, panel, node, box, origin)


def _draw_node(axes: "Axes", panel: Panel, node: Hashable, box: Box, origin: Point) -> None:
    from matplotlib.patches import FancyBboxPatch

    kind, is_start = panel.kinds[node], node == panel.start
    action = panel.skill.actions.actions[panel.skill.actions.index(kind)]
    is_skill = isinstance(action, SubSkill)
    fill = START if is_start else SKILL_FILL if is_skill else colour_of(panel.skill, kind)
    rim = INK if is_start else SKILL_RIM if is_skill else LINE
    shape = "square,pad=0" if is_start else "round,pad=0,rounding_size=0.1"
    x, y = origin[0] + box.x - box.width / 2, origin[1] + box.y - box.height / 2
    gid = f"node:{panel.path}:{panel.labels[node]}"

    def add(inset: float, **style: Any) -> None:
        size = (box.width - 2 * inset, box.height - 2 * inset)
        axes.add_patch(FancyBboxPatch((x + inset, y + inset), *size, boxstyle=shape, **style))

    add(0, facecolor=fill, edgecolor=rim, linewidth=1.0, zorder=3, gid=gid)
    if is_skill:
        inner = "white" if is_start else rim
        add(0.035, facecolor="none", edgecolor=inner, linewidth=0.8, zorder=4)
    axes.text(
        origin[0] + box.x, origin[1] + box.y, panel.labels[node], fontsize=NODE_TEXT,
        color="white" if is_start else INK, ha="center", va="center_baseline", zorder=5,
        gid=f"text:{gid}", parse_math=False,
    )  # fmt: skip


def colour_of(skill: Skill, kind: str) -> str:
    """The fill of an action's nodes: the paper's five have their own, others take turns."""
    return COLOURS.get(kind) or OTHERS[skill.actions.index(kind) % len(OTHERS)]


def _draw_link(axes: "Axes", panel: Panel, link: Link, route: Route, origin: Point) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    points = [(origin[0] + x, origin[1] + y) for x, y in route.points]
    label = (origin[0] + route.label[0], origin[1] + route.label[1])
    tail = panel.labels[link.tail]
    head = panel.labels[link.head] if link.head is not None else None
    gid = f"{'edge' if head else 'end'}:{panel.path}:{tail}:{link.outcome}" + (
        f":{head}" if head else ""
    )
    colour = BACK if route.upward or route.loop else LINE
    if head is None:
        good = panel.skill.actions.actions[
            panel.skill.actions.index(panel.kinds[link.tail])
        ].terminal[link.outcome]
        colour = END_GOOD if good else END_BAD
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
    if head is None:
        axes.text(
            *label, link.outcome, fontsize=LABEL_TEXT, color="white", ha="center", va="center",
            zorder=4, gid=f"text:{gid}", parse_math=False,
            bbox={"boxstyle": "round,pad=0.25,rounding_size=0.6", "fc": colour, "ec": "none"},
        )  # fmt: skip
    else:
        axes.text(
            *label, link.outcome, fontsize=LABEL_TEXT, color=colour, ha="left", va="center",
            zorder=4, gid=f"text:{gid}", parse_math=False,
        )  # fmt: skip
