"""What the robot perceives and what travels along the edges, in words and numbers."""

import html

from torch import Tensor

from cgtorch.tabletop.viewer.timeline import Timeline
from cgtorch.tabletop.world.percepts import BOX, parts_of

SEVEN = ("table x min", "table x max", "table y min", "table y max")
OBJECT = ("object x", "object y", "object z")
SIDE = ("table side, cos 2φ", "table side, sin 2φ")
MESSAGE = ("dx", "dy", "dθ")
UNITS = ("m", "m", "rad")
CELL = "padding:1px 10px 1px 0;font-variant-numeric:tabular-nums"


def percept_rows(percept: Tensor) -> list[tuple[str, str]]:
    """Names and values of a percept (D,)."""
    seen = parts_of(percept)
    names = [*SEVEN, *OBJECT, *SIDE[: len(seen.side)]]
    for k in range(len(seen.obstacles)):
        names += [f"box {k + 1} {name.removeprefix('table ')}" for name in SEVEN[:BOX]]
    return [(name, f"{value:.3f} m") for name, value in zip(names, percept.tolist(), strict=True)]


def message_rows(message: Tensor) -> list[tuple[str, str]]:
    """Names and values of a message (M,), none where there is no message."""
    if not message.isfinite().all():
        return []
    names = [MESSAGE[i] if i < len(MESSAGE) else f"{i}" for i in range(len(message))]
    units = [f" {UNITS[i]}" if i < len(UNITS) else "" for i in range(len(message))]
    return [(n, f"{v:+.3f}{u}") for n, v, u in zip(names, message.tolist(), units, strict=True)]


def headline(timeline: Timeline, frame: int) -> str:
    """One line: which step of how many, the node that runs, how it comes out."""
    run, k = timeline.execution, int(timeline.step[frame])
    if not run.steps:
        return f"{run.skill.name}: {run.end}"
    step = run.steps[k]
    skill, slot = step.places[-1]
    last = frame == len(timeline) - 1
    end = f" · {run.skill.name} ended with {run.end}" if last else ""
    return (
        f"step {k + 1} of {len(run.steps)}: {skill.name} · {step.name}_{slot} → {step.outcome}{end}"
    )


def readings_html(timeline: Timeline, frame: int) -> str:
    """The headline, the percept and the message at one picture, as HTML."""
    run = timeline.execution
    percept = run.percept[int(timeline.seen[frame])]
    message = run.message[min(int(timeline.step[frame]) + 1, len(run.message) - 1)]
    sent = message_rows(message) or [("none yet", "")]
    return (
        f'<div class="readings" style="padding:6px 12px;font-size:0.85em">'
        f"<b>{html.escape(headline(timeline, frame))}</b>"
        f'<div style="display:flex;gap:24px;margin-top:4px">'
        f"{_table('percept', percept_rows(percept))}{_table('message', sent)}</div></div>"
    )


def _table(title: str, rows: list[tuple[str, str]]) -> str:
    cells = "".join(
        f'<tr><td style="{CELL}">{html.escape(name)}</td>'
        f'<td style="{CELL};text-align:right">{html.escape(value)}</td></tr>'
        for name, value in rows
    )
    return f'<table style="border-collapse:collapse;align-self:start"><caption style="text-align:\
left;font-weight:600">{title}</caption>{cells}</table>'
