"""The panel beside the scene, as HTML: the skill's graph, and what the robot perceives."""

import re
from functools import cache

from markupsafe import Markup
from matplotlib import rc_context
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.graphs.clusters import Cluster, clusters_of
from cgtorch.report.graph_picture import draw_clusters, gid_of
from cgtorch.report.html import STYLE, inline_svg, templates
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.viewer.execution import Step
from cgtorch.tabletop.viewer.timeline import Timeline
from cgtorch.tabletop.world.percepts import percept_fields

TEMPLATES = templates("cgtorch.tabletop.viewer")
LIT, RIM = "#ffd60a", "#1c1f24"
SCALE = 0.94  # of pictures, where 1 is 96 pixels an inch
OUTER_HEIGHT = 2.1
"""The largest height, in inches, of a level that waits for the one within it."""


def levels_html(skill: Skill, step: Step) -> str:
    """The levels of a step, outermost first, as HTML, with its nodes and last edge highlighted."""
    clusters = [_clusters(skill)[id(inner)] for inner, _ in step.places]
    nodes = [c.nodes[f"{c.key}_n{s}"] for c, (_, s) in zip(clusters, step.places, strict=True)]
    ended = nodes[-1].key, step.outcome
    (edge,) = (e for e in clusters[-1].edges if (e.tail, e.outcome) == ended)
    gids = [gid_of(c, node) for c, node in zip(clusters, nodes, strict=True)]
    return TEMPLATES.get_template("levels.html").render(
        nodes=[(_selector(gid), _selector(f"text:{gid}")) for gid in gids],
        edge=_selector(gid_of(clusters[-1], edge)),
        pictures=[_picture(skill, inner, inner is step.places[-1][0]) for inner, _ in step.places],
        lit=LIT,
        rim=RIM,
    )


def _selector(gid: str) -> Markup:
    """The CSS selector of an element; names come from files and may contain anything."""
    escaped = re.sub(r"[^\w .:›-]", lambda found: f"\\{ord(found[0]):x} ", gid)
    return Markup(f'[data-part="{escaped}"]')  # noqa: S704  nothing of HTML is left


@cache
def _clusters(skill: Skill) -> dict[int, Cluster]:
    return {id(cluster.skill): cluster for cluster in clusters_of(skill)}


@cache
def _picture(skill: Skill, inner: Skill, last: bool) -> Markup:
    """One level as an SVG element."""
    cluster = _clusters(skill)[id(inner)]
    with rc_context(STYLE):
        figure = draw_clusters([cluster])
    scale = SCALE if last else min(SCALE, OUTER_HEIGHT / figure.get_size_inches()[1])
    return inline_svg(figure, cluster.key, cluster.path, scale)


def percept_rows(percept: Tensor) -> list[tuple[str, str]]:
    """Names and values of a percept (D,)."""
    values = zip(percept_fields(len(percept)), percept.tolist(), strict=True)
    return [(field.name, f"{value:.3f} {field.unit}") for field, value in values]


def message_rows(message: Tensor) -> list[tuple[str, str]]:
    """Names and values of a message (M,), none where there is no message."""
    if not message.isfinite().all():
        return []
    known = [(field.name, f" {field.unit}") for field in Tabletop.control]
    known += [(f"{i}", "") for i in range(len(known), len(message))]
    values = zip(known, message.tolist(), strict=False)
    return [(name, f"{value:+.3f}{unit}") for (name, unit), value in values]


def headline(timeline: Timeline, frame: int) -> str:
    """One line: the number of the step, the node that runs, and its outcome."""
    run, k = timeline.execution, int(timeline.step[frame])
    step = run.steps[k]
    skill, slot = step.places[-1]
    end = f" · {run.skill.name} ended with {run.end}" if frame == len(timeline) - 1 else ""
    node = f"{skill.name} · {step.name}_{slot}"
    return f"step {k + 1} of {len(run.steps)}: {node} → {step.outcome}{end}"


def readings_html(timeline: Timeline, frame: int) -> str:
    """The headline, the percept and the message at one picture, as HTML."""
    run = timeline.execution
    message = run.message[min(int(timeline.step[frame]) + 1, len(run.message) - 1)]
    return TEMPLATES.get_template("readings.html").render(
        headline=headline(timeline, frame),
        percept=percept_rows(run.percept[int(timeline.seen[frame])]),
        message=message_rows(message) or [("none yet", "")],
    )
