"""The sections of a run's page about its stages, finished or not, and about Γ and C."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import torch
from markupsafe import Markup
from torch import Tensor

from cgtorch.domains.live import Placements
from cgtorch.graphs import Skill
from cgtorch.graphs.clusters import Cluster, clusters_of
from cgtorch.ground.errors import RunError, printable
from cgtorch.report.graph_picture import draw_clusters
from cgtorch.report.html import inline_svg
from cgtorch.report.plots import draw_learning, draw_reliability
from cgtorch.runs.log import Row
from cgtorch.runs.stored_run import StoredRun

NONE = Markup("")
SCORES = {
    "gamma": "Γ: − error of what it learns",
    "classifier": "C: balanced accuracy",
}


@dataclass(frozen=True)
class Stage:
    """A finished stage or round: its result, and what the run could solve at its end."""

    name: str
    result: Row
    skill: Skill
    solved: Any  # W, all scenarios that the skill has succeeded on
    missed: Any  # M, all that it has failed on
    accepted: Row | None  # its row in the log; None if no skill was accepted


def stage_sections(run: StoredRun, stages: Sequence[Stage]) -> list[dict[str, Any]]:
    """Contents of all stages, and of the domain's missing ones unless it has rounds.

    `tested` is whether it is one of the domain's stages, which have tests of their own.
    """
    made, domain = {stage.name: stage for stage in stages}, run.domain
    wanted = list(made)
    if domain.stages and run.kind == domain.kinds[0] and not run.rounds:
        wanted = list(domain.stages)
    sections = []
    for name in wanted:
        kind, stage = domain.stages.get(name), made.get(name)
        section = {
            "name": name,
            "scenarios": kind or "",
            "tested": kind is not None,
            "published": run.pictures.published.get(name),
            "drawing": Markup(run.pictures.stage(name) if kind else ""),  # noqa: S704  its own
            "stage": stage,
        }
        if stage is not None:
            clusters = clusters_of(stage.skill)
            section |= {
                "scenarios": stage.result["scenarios"],
                "map": _map_of(stage, run, kind),
                "graph": _graph_of(stage, clusters),
                "panels": [*map(_panel, clusters)],
            }
        sections.append(section)
    return sections


def _map_of(stage: Stage, run: StoredRun, kind: str | None) -> tuple[Markup, str]:
    """A picture of all known results of a stage's skill; tests of a kind are marked."""
    solved, missed = len(stage.solved), len(stage.missed)
    if not solved + missed:
        return NONE, f"{stage.skill.name}: no scenarios are kept, as fresh episodes decide"
    words = f"{stage.skill.name}: {solved} scenarios {run.pictures.solved[0]}, {missed} missed"
    if isinstance(stage.solved, Placements):  # whose objects have no known places
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


def model_quality(rows: Sequence[Row]) -> dict[str, Any]:
    """The quality of the models by the `models` rows of the log: tables, and pictures."""
    reported = [row for row in rows if row.get("gamma") and row.get("classifier")]
    found: dict[str, Any] = {"seconds": [row["seconds"] for row in rows], "gamma": None}
    if not reported:
        return found
    gamma, classifier = reported[-1]["gamma"], reported[-1]["classifier"]
    _check_reports(gamma, classifier)
    columns = gamma["coordinates"], gamma["units"], gamma["error"], gamma["baseline_error"]
    errors = [
        (name, _in_unit(error, unit), _in_unit(baseline, unit))
        for name, unit, error, baseline in zip(*columns, strict=True)
    ]
    names = [f" for {name}" for name in gamma["coordinates"]]
    if len(names) != len(gamma["choice"]):  # so that it is not known what an output is about
        names = [""] * len(gamma["choice"])
    learning, reliability, curves = NONE, NONE, []
    for report, title in zip((gamma, classifier), SCORES.values(), strict=True):
        if (curve := report.get("learning_curve")) and curve["sizes"]:
            scores = curve["train_scores"], curve["test_scores"]
            curves.append((title, curve["sizes"], *([*map(fmean, each)] for each in scores)))
    if curves:
        label = "Learning curves of the models"
        learning = inline_svg(draw_learning(curves), "learning", label)
    if bins := classifier["reliability"]:
        figure = draw_reliability(bins, title="C", of="held-out labels")
        reliability = inline_svg(figure, "reliability", "Reliability diagram of C")
    return found | {
        "gamma": gamma,
        "classifier": classifier,
        "errors": errors,
        "choices": [each for each in zip(names, gamma["choice"], strict=True) if each[1]],
        "learning": learning,
        "reliability": reliability,
    }


def _check_reports(gamma: Row, classifier: Row) -> None:
    """RunError if the numbers of a report do not fit one another."""
    columns = gamma["coordinates"], gamma["units"], gamma["error"], gamma["baseline_error"]
    sound = len({*map(len, columns)}) == 1 and all(
        len(row) == 3 and 0 <= row[0] <= 1 and 0 <= row[1] <= 1 and row[2] >= 1
        for row in classifier["reliability"]
    )
    for curve in filter(None, (gamma.get("learning_curve"), classifier.get("learning_curve"))):
        for scores in (curve["train_scores"], curve["test_scores"]):
            sound &= len(scores) == len(curve["sizes"]) and all(scores)
    if not sound:
        raise RunError("a report of the models in the log is damaged; restore log.jsonl")


def _in_unit(value: float, unit: str) -> str:
    """An error in the unit of its number, with metres as centimetres."""
    return f"{100 * value:.2f} cm" if unit == "m" else f"{value:.3g} {unit}".rstrip()
