"""The skill's graph as the page shows it: each level that is running, its active node lit."""

import re
from functools import cache

from markupsafe import Markup
from matplotlib import rc_context

from cgtorch.graphs import Skill
from cgtorch.graphs.clusters import Cluster, clusters_of
from cgtorch.report.graph_picture import draw_clusters, gid_of
from cgtorch.report.html import STYLE, inline_svg, templates
from cgtorch.tabletop.viewer.execution import Step

LIT, RIM = "#ffd60a", "#1c1f24"
SCALE = 0.94  # of pictures, where 1 is 96 pixels an inch
OUTER_HEIGHT = 2.1
"""At most, in inches, of a level that only waits for the one within it."""


def levels_html(skill: Skill, step: Step) -> str:
    """The levels that a step runs in, the outermost first, as HTML with pictures in SVG.

    Lit are the node that runs, on every level, and the edge of its outcome on the last one.
    """
    clusters = [_clusters(skill)[id(inner)] for inner, _ in step.places]
    nodes = [c.nodes[f"{c.key}_n{s}"] for c, (_, s) in zip(clusters, step.places, strict=True)]
    ended = nodes[-1].key, step.outcome
    (edge,) = (e for e in clusters[-1].edges if (e.tail, e.outcome) == ended)
    gids = [gid_of(c, node) for c, node in zip(clusters, nodes, strict=True)]
    template = templates("cgtorch.tabletop.viewer").get_template("levels.html")
    return template.render(
        nodes=[(_selector(gid), _selector(f"text:{gid}")) for gid in gids],
        edge=_selector(gid_of(clusters[-1], edge)),
        pictures=[_picture(skill, inner, inner is step.places[-1][0]) for inner, _ in step.places],
        lit=LIT,
        rim=RIM,
    )


def _selector(gid: str) -> Markup:
    """What selects an element in CSS; names come from files and may hold anything."""
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
