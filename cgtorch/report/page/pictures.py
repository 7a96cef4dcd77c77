"""The pictures of a stage: what its skill reached, its graph, and the paper's experiment."""

from collections.abc import Hashable
from dataclasses import dataclass

import torch
from markupsafe import Markup
from matplotlib import rc_context
from torch import Tensor

from cgtorch.errors import printable
from cgtorch.graphs import Skill, to_networkx
from cgtorch.report.graph_picture import draw_skill, skills_of
from cgtorch.report.page.contents import Stage
from cgtorch.report.page.vector import STYLE, inline_svg
from cgtorch.report.table_picture import draw_scenes, draw_table_top
from cgtorch.world import Scenarios, concatenate_scenarios, stage_scenarios

MOST_MARKS = 1500  # objects drawn in one picture
SCENES = 24
ROOM = 14.0  # cm around the paper's drawings
Footprint = tuple[float, float, float, float]


@dataclass(frozen=True)
class Picture:
    """A picture and what it shows, in words."""

    svg: Markup
    text: str


def map_picture(stage: Stage, edge: str | None, footprint: Footprint) -> Picture:
    """All that is known of where a stage's skill succeeds, from above.

    Args:
        stage: of a run.
        edge: whose five test placements are ringed, if any.
        footprint: of the robot's base.
    """
    solved, missed = len(stage.solved), len(stage.missed)
    everything = concatenate_scenarios([stage.solved, stage.missed])
    good = torch.arange(solved + missed) < solved
    words = f"{stage.skill.name}: {solved} placements reached, {missed} missed"
    if not len(everything):
        return Picture(Markup(""), f"{stage.skill.name}: nothing was tried")
    one_table = len(torch.unique(everything.table, dim=0)) == 1
    targets = _among(everything, edge)
    if one_table:
        some = _some(good, targets, MOST_MARKS)
        with rc_context(STYLE):
            figure = draw_table_top(
                everything[some], good[some], targets[some], footprint=footprint
            )
            figure.axes[0].set_title("")  # which the caption says
        words += "" if edge is None else ", the test placements of this stage ringed"
    else:
        some = _some(good, targets, SCENES)
        with rc_context(STYLE):
            figure = draw_scenes(everything[some], good[some], footprint=footprint)
    words += f"; {len(some)} of them drawn" if len(some) < len(everything) else ""
    return Picture(inline_svg(figure, f"{stage.name}-map", f"Seen from above. {words}"), words)


def _among(scenarios: Scenarios, edge: str | None) -> Tensor:
    """Which of the scenarios (B,) are the test placements of an edge."""
    found = torch.zeros(len(scenarios), dtype=torch.bool)
    if edge is None:
        return found
    tests = stage_scenarios(edge)
    for i in range(len(tests)):
        same = [scenarios.pose == tests.pose[i], scenarios.object == tests.object[i]]
        found |= torch.cat(same, 1).all(1) & (scenarios.seed == tests.seed[i])
    return found


def _some(good: Tensor, targets: Tensor, most: int) -> Tensor:
    """Indices of at most so many rows: test placements and misses first, then evenly spread."""
    order = torch.arange(len(good))
    first = order[targets | ~good][:most]
    rest = order[~targets & good]
    left = most - len(first)
    if left < len(rest):
        rest = rest[torch.linspace(0, len(rest) - 1, max(left, 0)).long()]
    return torch.cat([first, rest]).sort().values


@dataclass(frozen=True)
class Panel:
    """One graph of a skill as a table: from which node, with which outcome, to which."""

    title: str
    start: str
    edges: tuple[tuple[str, str, str], ...]


def graph_picture(stage: Stage) -> tuple[Picture, tuple[Panel, ...]]:
    """The skill's graph like the paper's figures, and the same in words."""
    with rc_context(STYLE):
        figure = draw_skill(stage.skill)
    skill = stage.skill
    panels = tuple(_panel(inner, path) for inner, path in skills_of(skill))
    nodes, inner = skill.num_nodes, len(panels) - 1
    words = f"{skill.name}: {nodes} node{'s' if nodes != 1 else ''}, starting at {panels[0].start}"
    words += f", and {inner} skill{'s' if inner != 1 else ''} within" if inner else ""
    return Picture(inline_svg(figure, f"{stage.name}-graph", f"Graph of {words}"), words), panels


def _panel(skill: Skill, path: str) -> Panel:
    view = to_networkx(skill.graph, skill.actions)
    labels: dict[Hashable, str] = {n: printable(d["label"]) for n, d in view.nodes(data=True)}
    edges = [(labels[a], d["outcome"], labels[b]) for a, b, d in view.edges(data=True)]
    for node, data in view.nodes(data=True):
        action = skill.actions.actions[skill.actions.index(data["action"])]
        ends = ((o, good) for o, good in action.terminal.items() if o in action.outcomes)
        edges += [
            (labels[node], outcome, "the skill succeeds" if good else "the skill fails")
            for outcome, good in ends
        ]
    order = list(labels.values())
    edges.sort(key=lambda edge: order.index(edge[0]))
    return Panel(path, labels[view.graph["start"]], tuple(edges))


@dataclass(frozen=True)
class Experiment:
    """The paper's schematic drawing of an experiment, in cm, the robot's left to the left.

    Attributes:
        box: left, top, width and height of all.
        table: left, top, width and height.
        robot: the same of its base.
        objects: where they stand.
        ellipse: centre and radii around them.
    """

    box: tuple[float, ...]
    table: tuple[float, ...]
    robot: tuple[float, ...]
    objects: tuple[tuple[float, float], ...]
    ellipse: tuple[float, ...]


def experiment(edge: str, footprint: Footprint) -> Experiment:
    """The drawing for an edge, from the placements that a stage is tested on."""
    tests = stage_scenarios(edge)
    depth, width = tests.table[0, 3:5].tolist()
    x, y, _ = tests.pose[0].tolist()
    objects = (-100 * tests.object.flip(1)).tolist()
    low, high = torch.tensor(objects).aminmax(dim=0)
    middle, half = ((low + high) / 2).tolist(), ((high - low) / 2).tolist()
    x_min, x_max, y_min, y_max = footprint
    robot = _cm(x + x_max, y + y_max, x_max - x_min, y_max - y_min)
    table = _cm(depth / 2, width / 2, depth, width)
    left, top = table[0] - ROOM, table[1] - ROOM
    box = (left, top, table[2] + 2 * ROOM, robot[1] + robot[3] + ROOM - top)
    return Experiment(
        tuple(round(v, 1) for v in box),
        table,
        robot,
        tuple((round(a, 1), round(b, 1)) for a, b in objects),
        (*(round(v, 1) for v in middle), *(round(v + 11, 1) for v in half)),
    )


def _cm(x: float, y: float, depth: float, width: float) -> tuple[float, ...]:
    """A rectangle by its far left corner, as left, top, width and height."""
    return tuple(round(100 * v, 1) for v in (-y, -x, width, depth))
