"""The stages of a run, finished or not, with pictures of their results."""

from dataclasses import dataclass
from typing import Any

import torch
from markupsafe import Markup
from torch import Tensor

from cgtorch.domains.live import Placements
from cgtorch.domains.pictures import Published
from cgtorch.graphs.clusters import Cluster, clusters_of
from cgtorch.ground.errors import printable
from cgtorch.report.graph_picture import draw_clusters
from cgtorch.report.html import inline_svg
from cgtorch.report.page.contents import Contents, Stage
from cgtorch.runs.stored_run import StoredRun

NONE = Markup("")


@dataclass(frozen=True)
class StageSection:
    """The content of the page for a stage or round; some domains have no pictures.

    Attributes:
        scenarios: Its kind of scenarios.
        tested: Whether it is one of the domain's stages, which have tests of their own.
        drawing: A drawing of its task.
        stage: The finished stage, or None.
        map: A picture of what the skill solved.
        graph: A picture of its graph.
        panels: The graph as tables: title, start node, and for each outcome from node to node.
    """

    name: str
    scenarios: str
    tested: bool
    published: Published | None
    drawing: Markup
    stage: Stage | None = None
    map: tuple[Markup, str] = (NONE, "")
    graph: tuple[Markup, str] = (NONE, "")
    panels: tuple[tuple[str, str, list[tuple[str, str, str]]], ...] = ()


def stage_sections(contents: Contents) -> list[StageSection]:
    """All stages of the run, and the missing ones of its domain unless the run makes rounds."""
    made, run = {stage.name: stage for stage in contents.stages}, contents.run
    domain, wanted = run.domain, list(made)
    if domain.stages and run.kind == domain.kinds[0] and not run.rounds:
        wanted = list(domain.stages)
    sections = []
    for name in wanted:
        kind, stage = domain.stages.get(name), made.get(name)
        drawing = Markup(run.pictures.stage(name) if kind else "")  # noqa: S704  the domain's own
        about = kind is not None, run.pictures.published.get(name), drawing
        if stage is None:
            sections.append(StageSection(name, kind or "", *about))
            continue
        clusters = clusters_of(stage.skill)
        pictures = _map_of(stage, run, kind), _graph_of(stage, clusters)
        panels = tuple(map(_panel, clusters))
        scenarios = stage.result["scenarios"]
        sections.append(StageSection(name, scenarios, *about, stage, *pictures, panels))
    return sections


def _map_of(stage: Stage, run: StoredRun, kind: str | None) -> tuple[Markup, str]:
    """A picture of all known results of a stage's skill; tests of a kind are marked."""
    solved, missed = len(stage.solved), len(stage.missed)
    if not solved + missed:
        return NONE, f"{stage.skill.name}: nothing was tried"
    words = f"{stage.skill.name}: {solved} scenarios {run.pictures.solved[0]}, {missed} missed"
    if isinstance(stage.solved, Placements):  # of which nobody knows where things were
        return NONE, words
    everything = stage.solved.joined(stage.missed)
    good = torch.arange(solved + missed) < solved
    targets = _among(everything, None if kind is None else run.domain.tests(kind))
    figure = run.pictures.scenarios(everything, good, targets)
    if figure is None:
        return NONE, words
    for axes in figure.axes[:1]:
        axes.set_title("")  # which the caption says
    words += ", the tests of this stage marked" if targets.any() else ""
    words += f"; {figure.get_label()}" if figure.get_label() else ""
    return inline_svg(figure, f"{stage.name}-map", words), words


def _among(scenarios: Any, tests: Any) -> Tensor:
    """Which of the scenarios (B,) are among `tests`."""
    if tests is None or not len(tests):
        return torch.zeros(len(scenarios), dtype=torch.bool)
    found, wanted = (
        torch.cat([v.double().reshape(len(s), -1) for v in vars(s).values()], 1)
        for s in (scenarios, tests)
    )
    return (found[:, None] == wanted).all(2).any(1)


def _graph_of(stage: Stage, clusters: list[Cluster]) -> tuple[Markup, str]:
    """The skill's graph, like the paper's figures."""
    nodes, inner = stage.skill.num_nodes, len(clusters) - 1
    start = printable(clusters[0].nodes[clusters[0].start].label)
    words = f"{stage.skill.name}: {nodes} node{'s' if nodes != 1 else ''}, starting at {start}"
    words += f", and {inner} skill{'s' if inner != 1 else ''} within" if inner else ""
    return inline_svg(draw_clusters(clusters), f"{stage.name}-graph", f"Graph of {words}"), words


def _panel(cluster: Cluster) -> tuple[str, str, list[tuple[str, str, str]]]:
    said = {key: printable(node.label) for key, node in cluster.nodes.items()}
    ends = {key: f"the skill {'succeeds' if ok else 'fails'}" for key, ok in cluster.ends.items()}
    order = list(cluster.nodes)
    edges = sorted(cluster.edges, key=lambda edge: order.index(edge.tail))
    rows = [(said[e.tail], e.outcome, (said | ends)[e.head]) for e in edges]
    return cluster.path, said[cluster.start], rows
