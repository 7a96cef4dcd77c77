"""What events are called on the screen: one line each, without colour."""

from cgtorch.improvement.events import ModelsFitted, SkillAccepted, StageStarted, WorldTested
from cgtorch.report.estimate import as_time, stage_number


def stage_started(event: StageStarted) -> str:
    """The line for a stage that begins."""
    number, count = stage_number(event)
    return (
        f"{event.stage}: stage {number} of {count}, "
        f"{event.size_w} scenarios to keep (W), {event.size_m} to solve"
    )


def models_fitted(event: ModelsFitted) -> str:
    """The line for models that were trained."""
    gamma, classifier = event.knowledge.gamma_report, event.knowledge.classifier_report
    data = event.knowledge.dataset
    rows = f"{len(data.percept)} transitions and {len(data.graspable)} labels"
    if len(data.percept) > gamma.rows:
        return f"{event.stage}: Γ and C have learned on, now from {rows}, {event.seconds:.1f} s"
    error = dict(zip(gamma.coordinates, gamma.error, strict=True))
    object_error = (error["object x"] + error["object y"]) / 2
    table_error = sum(error[f"table {side}"] for side in ("x min", "x max", "y min", "y max")) / 4
    return (
        f"{event.stage}: Γ errs by {100 * object_error:.1f} cm on the object and "
        f"{100 * table_error:.1f} cm on the table, C is right on "
        f"{100 * classifier.balanced_accuracy:.1f} %; {rows}, {event.seconds:.1f} s"
    )


def world_tested(event: WorldTested) -> str:
    """The line for a candidate tried in the world."""
    text = (
        f"{event.candidate}: in the world W {event.solved_w}/{event.size_w}, "
        f"M {event.solved_m}/{event.size_m}"
    )
    if event.kept is not None and event.promised is not None:
        text += f"; of its group {event.kept} solved, {event.promised} promised by the models"
    return text


def skill_accepted(event: SkillAccepted) -> str:
    """The line for a skill that was accepted."""
    w, targets = event.succeeded[event.keep], event.targets
    others = event.succeeded[~event.keep]
    nodes = f"{event.skill.num_nodes} node{'s' if event.skill.num_nodes != 1 else ''}"
    parts = [
        f"test placements {int(event.succeeded[targets].sum())}/{int(targets.sum())}",
        f"W {int(w.sum())}/{len(w)}",
        f"M {int(others.sum())}/{len(others)}",
        f"{nodes} in {event.skill.depth} level{'s' if event.skill.depth != 1 else ''}",
        as_time(event.seconds),
    ]
    return f"{event.stage}: accepted; {', '.join(parts)}"
