"""The pictures of a stage: what its skill solved, and its graph."""

from dataclasses import dataclass
from typing import Any

import torch
from markupsafe import Markup
from matplotlib import rc_context
from torch import Tensor

from cgtorch.domains.domain import Domain
from cgtorch.graphs.clusters import Cluster, clusters_of
from cgtorch.ground.errors import printable
from cgtorch.report.graph_picture import draw_clusters
from cgtorch.report.html import STYLE, inline_svg
from cgtorch.report.page.contents import Stage


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
    clusters, name = clusters_of(stage.skill), stage.skill.name
    with rc_context(STYLE):
        figure = draw_clusters(clusters)
    panels = tuple(_panel(cluster) for cluster in clusters)
    nodes, inner = stage.skill.num_nodes, len(panels) - 1
    words = f"{name}: {nodes} node{'s' if nodes != 1 else ''}, starting at {panels[0].start}"
    words += f", and {inner} skill{'s' if inner != 1 else ''} within" if inner else ""
    return Picture(inline_svg(figure, f"{stage.name}-graph", f"Graph of {words}"), words), panels


def _panel(cluster: Cluster) -> Panel:
    said = {key: printable(node.label) for key, node in cluster.nodes.items()}
    ends = {key: f"the skill {'succeeds' if ok else 'fails'}" for key, ok in cluster.ends.items()}
    order = {key: i for i, key in enumerate(cluster.nodes)}
    edges = sorted(cluster.edges, key=lambda edge: order[edge.tail])
    rows = tuple((said[e.tail], e.outcome, (said | ends)[e.head]) for e in edges)
    return Panel(cluster.path, said[cluster.start], rows)
