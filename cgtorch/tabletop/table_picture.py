"""Scenes from above: where objects are, and which of them a skill reached."""

import math
from typing import TYPE_CHECKING, Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.geometry import bounding_box, box_rectangle, corners, rotate
from cgtorch.tabletop.world.percepts import present

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GOOD, BAD, TARGET, ROBOT, TABLE, RIM, OBSTACLE = (
    "#1a7f37", "#c62828", "#1c1f24", "#4a6fa5", "#f1e7d6", "#a58f6b", "#8b929c",
)  # fmt: skip
Box: TypeAlias = tuple[float, float, float, float]
FOOTPRINT: Box = (-0.334, 0.334, -0.334, 0.334)
AROUND = 0.25  # m of room around everything
LONGEST = 6.0  # inches of the longer side
MARGINS = 0.75, 0.2, 1.0, 0.5  # left, right, bottom and top, inches
MOST_ROBOTS = 60  # start poses that are drawn
PANEL = 2.2  # inches a side, of a scene of its own
MOST_MARKS = 1500  # objects drawn in one picture
SCENES, COLUMNS = 24, 4  # panels, and how many are side by side


def draw_table_top(
    scenarios: Scenarios,
    succeeded: Tensor,
    targets: Tensor | None = None,
    *,
    footprint: Box = FOOTPRINT,
    title: str = "",
) -> "Figure":
    """Top view to scale, as the robot sees it: away from it is up, its left is left.

    Green circles are objects that the skill reached, red crosses those it missed, and black rings
    mark test scenarios. Blue outlines are robots at their start, with their heading.

    Args:
        scenarios: The B scenarios.
        succeeded: (B,) bool.
        targets: (B,) bool, the test scenarios; none by default.
        footprint: Base x min, x max, y min, y max (m).
        title: A text before the counts.

    Raises:
        DataError: The numbers of results or targets and of scenarios differ.
    """
    from matplotlib.figure import Figure

    count = len(scenarios)
    good = succeeded.bool()
    marks = torch.zeros(count, dtype=torch.bool) if targets is None else targets.bool()
    if good.shape != (count,) or marks.shape != (count,):
        raise DataError(
            f"{count} scenarios with results of shape {tuple(good.shape)} and targets of "
            f"shape {tuple(marks.shape)}; give one of each for every scenario"
        )
    figure = Figure(dpi=100, facecolor="white")
    axes = figure.add_subplot()
    tables = torch.unique(scenarios.table, dim=0)
    _draw_all(axes, scenarios, good, marks, footprint)
    if len(tables) == 1:
        _name_edges(axes, tables[0])
    width, height = _frame(axes, scenarios, footprint)
    figure.set_size_inches(width, height)
    left, right, bottom, top = MARGINS  # which a layout engine takes a tenth of a second to find
    figure.subplots_adjust(left / width, bottom / height, 1 - right / width, 1 - top / height)
    axes.set_title(_caption(title, good, marks), fontsize=11, color=TARGET)
    if count:
        figure.legend(loc="lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def draw_placements(
    scenarios: Scenarios,
    succeeded: Tensor,
    targets: Tensor,
    *,
    footprint: Box = FOOTPRINT,
    title: str = "",
) -> "Figure":
    """`draw_table_top` for a single table, `draw_scenes` for several; of many scenarios, some.

    Test scenarios and missed ones are drawn first, the others evenly spread. The figure's label
    says how many are drawn.
    """
    one_table = len(torch.unique(scenarios.table, dim=0)) < 2
    some = _some(succeeded, targets, MOST_MARKS if one_table else SCENES)
    more = f", {len(some)} of them drawn" if len(some) < len(scenarios) else ""
    scenarios, good = scenarios[some], succeeded[some]
    if one_table:
        figure = draw_table_top(scenarios, good, targets[some], footprint=footprint, title=title)
    else:
        figure = draw_scenes(scenarios, good, footprint=footprint, title=title)
    figure.set_label(f"seen from above{more}")
    return figure


def _some(good: Tensor, targets: Tensor, most: int) -> Tensor:
    """Indices of at most `most` rows: test scenarios and misses first, then evenly spread."""
    order = torch.arange(len(good))
    first = order[targets | ~good][:most]
    rest = order[~targets & good]
    left = most - len(first)
    if left < len(rest):
        rest = rest[torch.linspace(0, len(rest) - 1, max(left, 0)).long()]
    return torch.cat([first, rest]).sort().values


def draw_scenes(
    scenarios: Scenarios, succeeded: Tensor, *, footprint: Box = FOOTPRINT, title: str = ""
) -> "Figure":
    """Each scene in its own panel, all to the same scale, for different tables.

    Marks are those of `draw_table_top`; obstacles are grey. The world's x is up, y to the left.
    DataError if the numbers of results and scenarios differ, or there is no scenario.
    """
    from matplotlib.figure import Figure

    count = len(scenarios)
    if succeeded.shape != (count,) or not count:
        raise DataError(
            f"{count} scenarios with results of shape {tuple(succeeded.shape)}; give at least one "
            "scenario and a result for each"
        )
    good, none = succeeded.bool(), torch.zeros(1, dtype=torch.bool)
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    size = (columns * PANEL, rows * PANEL + 0.5)
    figure = Figure(figsize=size, dpi=100, facecolor="white", layout="constrained")
    scenes = [scenarios[i : i + 1] for i in range(count)]
    bounds = torch.stack([torch.stack(_bounds(scene, footprint)) for scene in scenes])
    half = float((bounds[:, 1] - bounds[:, 0]).amax() + AROUND) / 2
    for i, scene in enumerate(scenes):
        axes = figure.add_subplot(rows, columns, i + 1, aspect="equal", xticks=[], yticks=[])
        _draw_all(axes, scene, good[i : i + 1], none, footprint)
        x, y = bounds[i].mean(0).tolist()
        axes.set_xlim(y + half, y - half)
        axes.set_ylim(x - half, x + half)
    figure.suptitle(f"{_caption(title, good, none)}; panels {2 * half:.1f} m across", fontsize=11)
    return figure


def _caption(title: str, good: Tensor, marks: Tensor) -> str:
    text = f"{int(good.sum())} of {len(good)} reached"
    if marks.any():
        text += f"\n{int((good & marks).sum())} of {int(marks.sum())} test placements"
    return f"{title}: {text}" if title else text


def _on_paper(points: Tensor) -> Tensor:
    """World x, y (..., 2) as plot coordinates: y, which grows to the left, and x."""
    return points.flip(-1)


def _draw_all(
    axes: "Axes", scenarios: Scenarios, good: Tensor, marks: Tensor, footprint: Box
) -> None:
    """Tables, obstacles, robots and objects of scenarios, each once."""
    from matplotlib.patches import Polygon

    tables = torch.unique(scenarios.table[:, :5], dim=0)
    for things, face, edge, name in (
        (tables, TABLE, RIM, "table"),
        (scenarios.obstacles.flatten(0, 1), OBSTACLE, TARGET, "obstacle"),
    ):
        for outline in _on_paper(corners(things[present(things)])):
            axes.add_patch(Polygon(outline, gid=name, fc=face, ec=edge, lw=1.4, zorder=1))
    _draw_robots(axes, torch.unique(scenarios.pose, dim=0), footprint)
    _draw_objects(axes, _on_paper(scenarios.object), good, marks)


def _name_edges(axes: "Axes", table: Tensor) -> None:
    """Write the names of the table's edges, as the robot sees them."""
    yaw, half = table[2], table[3:5] / 2 + 0.07
    for name, side, turn in (
        ("near", (-1, 0), 0), ("far", (1, 0), 0), ("left", (0, 1), 90), ("right", (0, -1), -90),
    ):  # fmt: skip
        x, y = _on_paper(rotate(half * torch.tensor(side), yaw) + table[:2]).tolist()
        axes.text(
            x, y, name, color="#7a6745", fontsize=10, style="italic", ha="center", va="center",
            rotation=turn + math.degrees(yaw), zorder=2,
        )  # fmt: skip


def _draw_robots(axes: "Axes", poses: Tensor, footprint: Box) -> None:
    """Robots at poses (n, 3); some of them if there are many."""
    from matplotlib.collections import LineCollection, PolyCollection

    poses = poses[:: max(1, -(-len(poses) // MOST_ROBOTS))]
    if not len(poses):
        return
    ring = corners(box_rectangle(torch.tensor(footprint)))
    nose = torch.tensor([[0.0, 0.0], [footprint[1], 0.0]])
    outline, heading = (
        list(_on_paper(rotate(line[None], poses[:, 2, None]) + poses[:, None, :2]).numpy())
        for line in (ring, nose)
    )
    faint = (ROBOT, min(0.8, 8 / len(poses)))
    fill = (ROBOT, 0.12 if len(poses) == 1 else 0.0)
    style: dict[str, Any] = {"edgecolors": [faint], "linewidths": 0.9, "zorder": 2}
    about: dict[str, Any] = {"gid": "robots", "label": "robot at its start"}
    axes.add_collection(PolyCollection(outline, facecolors=[fill], **style, **about))
    axes.add_collection(LineCollection(heading, **style))


def _draw_objects(axes: "Axes", at: Tensor, good: Tensor, marks: Tensor) -> None:
    """Objects at places (n, 2) on the paper."""
    fine: dict[str, Any] = {"s": 26 if len(at) > 120 else 40, "lw": 0.6, "ec": "white"}
    ring: dict[str, Any] = {"s": 150, "lw": 1.6, "ec": TARGET}
    for gid, name, chosen, marker, colour, zorder, style in (
        ("reached", "reached", good, "o", GOOD, 4, fine),
        ("missed", "missed", ~good, "X", BAD, 5, fine),
        ("targets", "test placements", marks, "o", "none", 6, ring),
    ):
        if chosen.any():
            axes.scatter(
                at[chosen, 0].numpy(), at[chosen, 1].numpy(), marker=marker, fc=colour,
                zorder=zorder, gid=gid, label=f"{name} ({int(chosen.sum())})", **style,
            )  # fmt: skip


def _frame(axes: "Axes", scenarios: Scenarios, footprint: Box) -> tuple[float, float]:
    """Set limits around everything; returns the suitable size in inches."""
    from matplotlib.ticker import MultipleLocator

    size = (4.2, 4.2)
    if len(scenarios):
        (x0, y0), (x1, y1) = (bound.tolist() for bound in _bounds(scenarios, footprint))
        width, height = y1 - y0 + AROUND, x1 - x0 + AROUND
        axes.set_xlim(y1 + AROUND / 2, y0 - AROUND / 2)
        axes.set_ylim(x0 - AROUND / 2, x1 + AROUND / 2)
        scale = LONGEST / max(width, height)
        left, right, bottom, top = MARGINS
        size = (max(width * scale + left + right, 4.2), height * scale + bottom + top)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(0.5))
    axes.set(aspect="equal", axisbelow=True)
    axes.set(xlabel="y (m), to the robot's left", ylabel="x (m), away from the robot")
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    return size


def _bounds(scenarios: Scenarios, footprint: Box) -> tuple[Tensor, Tensor]:
    """Least and largest x, y (2,) of everything in at least one scenario."""
    base = max(abs(v) for v in footprint) * 1.2
    obstacles = scenarios.obstacles[present(scenarios.obstacles)]
    boxes = bounding_box(torch.cat([scenarios.table[:, :5], obstacles]))
    low = [scenarios.pose[:, :2] - base, scenarios.object, boxes[:, [0, 2]]]
    high = [scenarios.pose[:, :2] + base, scenarios.object, boxes[:, [1, 3]]]
    return torch.cat(low).amin(0), torch.cat(high).amax(0)
