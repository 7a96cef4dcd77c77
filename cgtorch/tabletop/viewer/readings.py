"""What the robot perceives and what travels along the edges, in words and numbers."""

from torch import Tensor

from cgtorch.report.html import templates
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.viewer.timeline import Timeline
from cgtorch.tabletop.world.percepts import percept_fields


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
    """One line: which step of how many, the node that runs, how it comes out."""
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
    template = templates("cgtorch.tabletop.viewer").get_template("readings.html")
    return template.render(
        headline=headline(timeline, frame),
        percept=percept_rows(run.percept[int(timeline.seen[frame])]),
        message=message_rows(message) or [("none yet", "")],
    )
