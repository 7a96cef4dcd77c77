"""Scenes from above: where the objects stood and which of them a skill reached."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.geometry import bounding_box, corners, rotate
from cgtorch.tabletop.world.percepts import present

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GOOD, BAD, TARGET, ROBOT, TABLE, RIM, OBSTACLE = (
    "#1a7f37", "#c62828", "#1c1f24", "#4a6fa5", "#f1e7d6", "#a58f6b", "#8b929c",
)  # fmt: skip
FOOTPRINT = (-0.334, 0.334, -0.334, 0.334)
AROUND = 0.25  # m of room around everything
LONGEST = 6.0  # inches of the longer side
MOST_ROBOTS = 60  # start poses that are drawn
PANEL = 2.2  # inches a side, of a scene of its own
MOST_MARKS = 1500  # objects drawn in one picture
SCENES = 24


def draw_table_top(
    scenarios: Scenarios,
    succeeded: Tensor,
    targets: Tensor | None = None,
    *,
    footprint: tuple[float, float, float, float] = FOOTPRINT,
    title: str = "",
) -> "Figure":
    """Top view in scale, as the robot sees it: away from it is up, its left is left.

    Green circles are objects the skill reached, red crosses those it missed, a black ring marks
    the test placements; blue outlines are the robots at their start, each with its heading.

    Args:
        scenarios: the B scenarios.
        succeeded: (B,) bool.
        targets: (B,) bool, the test placements; none if not given.
        footprint: base x min, x max, y min, y max (m).
        title: stands before the counts.

    Raises:
        DataError: another number of results or targets than scenarios.
    """
    from matplotlib.figure import Figure

    count = len(scenarios)
    marks = torch.zeros(count, dtype=torch.bool) if targets is None else targets.bool()
    if succeeded.shape != (count,) or marks.shape != (count,):
        raise DataError(
            f"{count} scenarios with results of shape {tuple(succeeded.shape)} and targets of "
            f"shape {tuple(marks.shape)}; give one of each for every scenario"
        )
    good = succeeded.bool()
    figure = Figure(dpi=100, facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    tables = torch.unique(scenarios.table, dim=0)
    for table in tables:
        _draw_table(axes, table, named=len(tables) == 1)
    for obstacle in scenarios.obstacles.flatten(0, 1):
        _draw_rectangle(axes, obstacle, OBSTACLE, TARGET, "obstacle")
    _draw_robots(axes, scenarios.pose, footprint)
    _draw_objects(axes, scenarios.object, good, marks)
    figure.set_size_inches(_frame(axes, scenarios, footprint))
    axes.set_title(_caption(title, good, marks), fontsize=11, color=TARGET)
    if count:
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=2, frameon=False, fontsize=9
        )
    return figure


def draw_placements(
    scenarios: Scenarios,
    succeeded: Tensor,
    targets: Tensor,
    *,
    footprint: tuple[float, float, float, float] = FOOTPRINT,
    title: str = "",
) -> "Figure":
    """`draw_table_top` of scenarios at one table, `draw_scenes` of others; of many, some.

    Test placements and what was missed are drawn first, the others evenly spread; the figure's
    label says how many are drawn.
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
    """Indices of at most so many rows: test placements and misses first, then evenly spread."""
    order = torch.arange(len(good))
    first = order[targets | ~good][:most]
    rest = order[~targets & good]
    left = most - len(first)
    if left < len(rest):
        rest = rest[torch.linspace(0, len(rest) - 1, max(left, 0)).long()]
    return torch.cat([first, rest]).sort().values


def draw_scenes(
    scenarios: Scenarios,
    succeeded: Tensor,
    *,
    footprint: tuple[float, float, float, float] = FOOTPRINT,
    columns: int = 4,
    title: str = "",
) -> "Figure":
    """Each scene in a panel of its own, all in one scale, for tables that differ.

    Marks are those of `draw_table_top`; obstacles are grey. The world's x is up, y to the left.

    Args:
        scenarios: the B scenarios.
        succeeded: (B,) bool.
        footprint: base x min, x max, y min, y max (m).
        columns: panels side by side.
        title: stands before the counts.

    Raises:
        DataError: another number of results than scenarios, or no scenario.
    """
    from matplotlib.figure import Figure

    count = len(scenarios)
    if succeeded.shape != (count,) or not count:
        raise DataError(
            f"{count} scenarios with results of shape {tuple(succeeded.shape)}; give at least one "
            "scenario and a result for each"
        )
    good, none = succeeded.bool(), torch.zeros(1, dtype=torch.bool)
    columns = min(columns, count)
    rows = -(-count // columns)
    size = (columns * PANEL, rows * PANEL + 0.5)
    figure = Figure(figsize=size, dpi=100, facecolor="white", layout="constrained")
    scenes = [scenarios[i : i + 1] for i in range(count)]
    bounds = torch.stack([torch.stack(_bounds(scene, footprint)) for scene in scenes])
    half = float((bounds[:, 1] - bounds[:, 0]).amax() + AROUND) / 2
    for i, scene in enumerate(scenes):
        axes = figure.add_subplot(rows, columns, i + 1)
        _draw_table(axes, scene.table[0], named=False)
        for obstacle in scene.obstacles[0]:
            _draw_rectangle(axes, obstacle, OBSTACLE, TARGET, "obstacle")
        _draw_robots(axes, scene.pose, footprint)
        _draw_objects(axes, scene.object, good[i : i + 1], none)
        x, y = bounds[i].mean(0).tolist()
        axes.set_xlim(y + half, y - half)
        axes.set_ylim(x - half, x + half)
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
    figure.suptitle(f"{_caption(title, good, none)}; panels {2 * half:.1f} m across", fontsize=11)
    return figure


def _caption(title: str, good: Tensor, marks: Tensor) -> str:
    text = f"{int(good.sum())} of {len(good)} reached"
    if marks.any():
        text += f"\n{int((good & marks).sum())} of {int(marks.sum())} test placements"
    return f"{title}: {text}" if title else text


def _corners(box: tuple[float, float, float, float]) -> Tensor:
    """(4, 2) corners of x min, x max, y min, y max."""
    x0, x1, y0, y1 = box
    return torch.tensor([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _on_paper(points: Tensor) -> Tensor:
    """World x, y (..., 2) as plot coordinates: y, which grows to the left, and x."""
    return points.flip(-1)


def _draw_rectangle(axes: "Axes", rectangle: Tensor, face: str, edge: str, gid: str) -> None:
    """A rectangle (5,) of the world; one of size 0 is none."""
    from matplotlib.patches import Polygon

    if bool(present(rectangle)):
        outline = _on_paper(corners(rectangle))
        axes.add_patch(Polygon(outline, facecolor=face, edgecolor=edge, lw=1.4, zorder=1, gid=gid))


def _draw_table(axes: "Axes", table: Tensor, named: bool) -> None:
    _draw_rectangle(axes, table[:5], TABLE, RIM, "table")
    x, y, yaw, depth, width = table[:5].tolist()
    centre, angle = torch.tensor([x, y]), torch.tensor(yaw)
    if not named:
        return
    out = 0.07
    for name, at, turn in (
        ("near", (-depth / 2 - out, 0.0), 0),
        ("far", (depth / 2 + out, 0.0), 0),
        ("left", (0.0, width / 2 + out), 90),
        ("right", (0.0, -width / 2 - out), -90),
    ):
        px, py = _on_paper(rotate(torch.tensor(at), angle) + centre).tolist()
        axes.text(
            px, py, name, color="#7a6745", fontsize=10, style="italic", ha="center", va="center",
            rotation=turn + yaw * 57.2958, zorder=2,
        )  # fmt: skip


def _draw_robots(axes: "Axes", pose: Tensor, footprint: tuple[float, float, float, float]) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    poses = torch.unique(pose, dim=0)
    step = max(1, -(-len(poses) // MOST_ROBOTS))
    poses = poses[::step]
    if not len(poses):
        return
    outline = rotate(_corners(footprint)[None], poses[:, 2, None]) + poses[:, None, :2]
    nose = torch.tensor([[0.0, 0.0], [footprint[1], 0.0]])
    heading = rotate(nose[None], poses[:, 2, None]) + poses[:, None, :2]
    faint = min(0.8, max(0.12, 8 / len(poses)))
    fill = (*_rgb(ROBOT), 0.12 if len(poses) == 1 else 0.0)
    axes.add_collection(
        PolyCollection(
            list(_on_paper(outline).numpy()),
            facecolors=[fill],
            edgecolors=[(*_rgb(ROBOT), faint)],
            linewidths=0.9,
            zorder=2,
            gid="robots",
            label="robot at its start",
        )
    )
    axes.add_collection(
        LineCollection(
            list(_on_paper(heading).numpy()),
            colors=[(*_rgb(ROBOT), faint)],
            linewidths=0.9,
            zorder=2,
        )
    )


def _rgb(colour: str) -> tuple[float, float, float]:
    r, g, b = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return r, g, b


def _draw_objects(axes: "Axes", placed: Tensor, good: Tensor, marks: Tensor) -> None:
    at = _on_paper(placed)
    crowd = 26 if len(at) > 120 else 40
    for name, chosen, marker, colour in (("reached", good, "o", GOOD), ("missed", ~good, "X", BAD)):
        if chosen.any():
            axes.scatter(
                at[chosen, 0].numpy(), at[chosen, 1].numpy(), s=crowd, marker=marker,
                facecolors=colour, edgecolors="white", linewidths=0.6,
                zorder=4 + (name == "missed"), gid=name, label=f"{name} ({int(chosen.sum())})",
            )  # fmt: skip
    if marks.any():
        axes.scatter(
            at[marks, 0].numpy(), at[marks, 1].numpy(), s=150, marker="o",
            facecolors="none", edgecolors=TARGET, linewidths=1.6, zorder=6, gid="targets",
            label=f"test placements ({int(marks.sum())})",
        )  # fmt: skip


def _frame(
    axes: "Axes",
    scenarios: Scenarios,
    footprint: tuple[float, float, float, float],
) -> tuple[float, float]:
    """Limits around everything, the robot's left to the left; the size in inches that suits."""
    from matplotlib.ticker import MultipleLocator

    size = (4.2, 4.2)
    if len(scenarios):
        (x0, y0), (x1, y1) = (bound.tolist() for bound in _bounds(scenarios, footprint))
        width, height = y1 - y0 + AROUND, x1 - x0 + AROUND
        axes.set_xlim(y1 + AROUND / 2, y0 - AROUND / 2)
        axes.set_ylim(x0 - AROUND / 2, x1 + AROUND / 2)
        scale = LONGEST / max(width, height)
        size = (max(width * scale + 0.9, 4.2), height * scale + 1.3)
    axes.set_aspect("equal")
    axes.xaxis.set_major_locator(MultipleLocator(0.5))
    axes.yaxis.set_major_locator(MultipleLocator(0.5))
    axes.set_xlabel("y (m), to the robot's left")
    axes.set_ylabel("x (m), away from the robot")
    axes.grid(color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return size


def _bounds(
    scenarios: Scenarios, footprint: tuple[float, float, float, float]
) -> tuple[Tensor, Tensor]:
    """Least and largest x, y (2,) of all that is in at least one scenario."""
    base = max(abs(v) for v in footprint) * 1.2
    obstacles = scenarios.obstacles[present(scenarios.obstacles)]
    boxes = bounding_box(torch.cat([scenarios.table[:, :5], obstacles]))
    low = [scenarios.pose[:, :2] - base, scenarios.object, boxes[:, [0, 2]]]
    high = [scenarios.pose[:, :2] + base, scenarios.object, boxes[:, [1, 3]]]
    return torch.cat(low).amin(0), torch.cat(high).amax(0)
