"""The pictures of a stage: what its skill solved, and its graph."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import torch
from markupsafe import Markup
from matplotlib import rc_context
from torch import Tensor

from cgtorch.domains.domain import Domain
from cgtorch.graphs import Skill, to_networkx
from cgtorch.ground.errors import printable
from cgtorch.report.graph_picture import draw_skill, skills_of
from cgtorch.report.page.contents import Stage
from cgtorch.report.page.vector import STYLE, inline_svg


@dataclass(frozen=True)
class Picture:
    """A picture and what it shows, in words."""

    svg: Markup
    text: str


def map_picture(stage: Stage, domain: Domain[Any], tests: str | None) -> Picture:
    """All that is known of where a stage's skill succeeds, if the domain can draw it.

    Args:
        stage: of a run.
        domain: what the run is about.
        tests: the kind of scenarios whose tests are marked, if any.
    """
    solved, missed = len(stage.solved), len(stage.missed)
    words = f"{stage.skill.name}: {solved} scenarios {domain.solved[0]}, {missed} missed"
    if not solved + missed:
        return Picture(Markup(""), f"{stage.skill.name}: nothing was tried")
    everything = stage.solved.joined(stage.missed)
    good = torch.arange(solved + missed) < solved
    targets = _among(everything, None if tests is None else domain.tests(tests))
    with rc_context(STYLE):
        figure = domain.draw_scenarios(everything, good, targets)
        if figure is None:
            return Picture(Markup(""), words)
        for axes in figure.axes[:1]:
            axes.set_title("")  # which the caption says
    words += ", the tests of this stage marked" if targets.any() else ""
    words += f"; {figure.get_label()}" if figure.get_label() else ""
    return Picture(inline_svg(figure, f"{stage.name}-map", words), words)


def _among(scenarios: Any, tests: Any) -> Tensor:
    """Which of the scenarios (B,) are among those of a test."""
    if tests is None or not len(tests):
        return torch.zeros(len(scenarios), dtype=torch.bool)
    known = {tuple(row) for row in _rows(tests).tolist()}
    return torch.tensor([tuple(row) in known for row in _rows(scenarios).tolist()])


def _rows(scenarios: Any) -> Tensor:
    """All numbers of each scenario (B, N)."""
    return torch.cat(
        [
            v.double().flatten(1) if v.dim() > 1 else v.double()[:, None]
            for v in vars(scenarios).values()
        ],
        1,
    )


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
