"""The skill's graph as the page shows it: each level that is running, its active node lit."""

import html
import io
import math
import re
from functools import cache

from cgtorch.graphs import NO_NODE, Skill
from cgtorch.report.graph_picture import draw_level, skills_of
from cgtorch.tabletop.viewer.execution import Step

LIT, RIM = "#ffd60a", "#1c1f24"
RIM_OF = f"stroke: {RIM} !important; stroke-width: {{}}px !important"
SCALE, OUTER_HEIGHT = 90, 200
"""Pixels per inch, and at most of the height of a level that only waits for the one within it."""
POINTS_PER_INCH = 72


def levels_html(skill: Skill, step: Step) -> str:
    """The levels that a step runs in, the outermost first, as HTML with pictures in SVG.

    Lit are the node that runs, on every level, and the edge of its outcome on the last one.

    Args:
        skill: the whole skill.
        step: one of its steps.
    """
    paths = {id(inner): path for inner, path in skills_of(skill)}
    parts = []
    for level, (inner, slot) in enumerate(step.places):
        path, last = paths[id(inner)], level == len(step.places) - 1
        node = f"node:{path}:{_label(inner, slot)}"
        marks = [
            f"{_selector(node)} path {{fill: {LIT} !important; {RIM_OF.format(2.5)}}}",
            f"{_selector(f'text:{node}')} * {{fill: {RIM} !important}}",
        ]
        if last:
            marks.append(f"{_selector(_edge(inner, path, slot, step))} path {{{RIM_OF.format(3)}}}")
        most = math.inf if last else OUTER_HEIGHT
        parts.append(f"<style>{' '.join(marks)}</style>{_picture(inner, path, most)}")
    outer, innermost = parts[:-1], parts[-1]
    rows = f'<div style="display:flex;flex-wrap:wrap;gap:6px">{"".join(outer)}</div>'
    return f'<div class="graph-levels" style="padding:6px">{rows if outer else ""}{innermost}</div>'


def _selector(gid: str) -> str:
    """What selects an element in CSS; names come from files and may hold anything."""
    escaped = re.sub(r"[^\w .:›-]", lambda found: f"\\{ord(found[0]):x} ", gid)
    return f'[id="{escaped}"]'


def _label(skill: Skill, slot: int) -> str:
    return f"{skill.actions.names[int(skill.graph.action[0, slot])]}_{slot}"


def _edge(skill: Skill, path: str, slot: int, step: Step) -> str:
    """The gid of the edge or end that the step's outcome leads to."""
    action = skill.actions.actions[int(skill.graph.action[0, slot])]
    head = int(skill.graph.edges[0, slot, action.outcomes.index(step.outcome)])
    if head == NO_NODE:
        return f"end:{path}:{_label(skill, slot)}:{step.outcome}"
    return f"edge:{path}:{_label(skill, slot)}:{step.outcome}:{_label(skill, head)}"


@cache
def _picture(skill: Skill, path: str, most: float) -> str:
    """One level as an SVG element, `most` pixels high at most."""
    file = io.StringIO()
    figure = draw_level(skill, path)
    figure.savefig(file, format="svg", metadata={"Date": None})
    width, height = figure.get_size_inches()
    scale = min(SCALE, most / height)
    box = f"0 0 {width * POINTS_PER_INCH:.2f} {height * POINTS_PER_INCH:.2f}"
    text = file.getvalue()
    inside = text[text.index(">", text.index("<svg")) + 1 :]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="{box}" width="{width * scale:.0f}" style="max-width:100%;height:auto" '
        f'role="img" aria-label="{html.escape(path)}">{inside}'
    )
