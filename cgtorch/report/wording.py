"""What events are called on the screen: one line each, without colour."""

from typing import Any

from cgtorch.improvement.events import (
    EvolutionRecalled,
    FreshTested,
    JournalDamaged,
    ModelsFitted,
    SkillAccepted,
    StageStarted,
    WorldTested,
)
from cgtorch.improvement.knowledge import Knowledge
from cgtorch.models import TransitionQuality, TransitionReport, Verdict
from cgtorch.report.estimate import as_time, stage_number


def stage_started(event: StageStarted) -> str:
    """The line for a stage that begins."""
    number, count = stage_number(event)
    return (
        f"{event.stage}: stage {number} of {count}, "
        f"{event.size_w} scenarios to keep (W), {event.size_m} to solve"
    )


def journal_read(event: EvolutionRecalled | JournalDamaged) -> str:
    """The line for what a journal knew from before an interruption, or could not be read."""
    if isinstance(event, EvolutionRecalled):
        return f"{event.candidate}: {event.generations} generations are known from before"
    files = ", ".join(event.files)
    return f"{event.stage}: damaged, so what it held is done again: {files}"


def models_fitted(event: ModelsFitted) -> str:
    """The line for models that were trained."""
    knowledge = event.knowledge
    if not isinstance(knowledge, Knowledge):  # of another domain, about which nothing is known here
        return f"{event.stage}: the models have learned, {event.seconds:.1f} s"
    data = knowledge.dataset
    rows = f"{len(data.percept)} transitions and {len(data.graspable)} labels"
    if knowledge.verdicts is not None:
        said = "; ".join(map(_learned, ("Γ", "C"), knowledge.verdicts))
        return f"{event.stage}: {said}; now from {rows}, {event.seconds:.1f} s"
    quality = event.gamma_quality
    about = _cross_validated(knowledge.gamma_report) if quality is None else _on_fresh(quality)
    return f"{event.stage}: {about}, {_on_labels(event)}; {rows}, {event.seconds:.1f} s"


def _on_labels(event: ModelsFitted) -> str:
    """How good C is, on fresh labels beside the most that is possible if that is known."""
    quality = event.classifier_quality
    if quality is None:
        return f"C is right on {100 * event.knowledge.classifier_report.balanced_accuracy:.1f} %"
    draws = (("near the object", quality.near), ("overall", quality.overall))
    said = (
        f"{100 * one.balanced:.1f} % {where} (possible {100 * one.possible_balanced:.1f})"
        for where, one in draws
    )
    return f"C's balanced accuracy on fresh labels is {' and '.join(said)}"


def _learned(name: str, verdict: Verdict) -> str:
    """What was decided about a model that learned on."""
    if verdict.accepted:
        return f"{name} has learned on"
    return (
        f"{name} stays as it was, since its error on earlier data would be "
        f"{verdict.after:.4f} instead of {verdict.before:.4f}"
    )


def _on_fresh(quality: TransitionQuality) -> str:
    """Γ's errors on fresh transitions, each beside what no model can better."""
    return (
        f"on {quality.rows} fresh transitions Γ errs by {100 * quality.object_error:.2f} cm on the "
        f"object (floor {100 * quality.object_floor:.2f}; without the noise of the motion "
        f"{100 * quality.object_offset:.2f}) and {100 * quality.table_error:.2f} cm on the table "
        f"(floor {100 * quality.table_floor:.2f} ± {100 * quality.table_floor_error:.2f})"
    )


def _cross_validated(report: TransitionReport) -> str:
    """Γ's errors in cross-validation."""
    error = dict(zip(report.coordinates, report.error, strict=True))
    object_error = (error["object x"] + error["object y"]) / 2
    table_error = sum(error[f"table {side}"] for side in ("x min", "x max", "y min", "y max")) / 4
    return (
        f"Γ errs by {100 * object_error:.1f} cm on the object and "
        f"{100 * table_error:.1f} cm on the table"
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


def skill_accepted(event: SkillAccepted[Any]) -> str:
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


def fresh_tested(event: FreshTested) -> str:
    """The line for a skill tried on fresh placements."""
    share = event.succeeded / max(1, event.tried)
    kind = "to decide, " if event.decisive else ""
    return (
        f"{event.stage}: {kind}{event.succeeded} of {event.tried} fresh placements = {share:.1%}, "
        f"the goal is {event.target:.4g}"
    )
