"""How good the tabletop's first Γ and C are, each beside the best that a percept allows."""

from dataclasses import dataclass, replace

from torch import Generator

from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.summary import rows_of, scalars_of, summary_of
from cgtorch.domains.transition import TransitionModel
from cgtorch.improvement.events import ModelSummary
from cgtorch.tabletop.data import Scenes
from cgtorch.tabletop.models.success_quality import (
    FreshLabels,
    SuccessQuality,
    fresh_labels,
    success_quality,
)
from cgtorch.tabletop.models.transition_quality import TransitionQuality, transition_quality

FRESH_TRANSITIONS = 1500  # which tell the models' errors
FRESH_LABELS = 500  # at most, as many as were learnt from


@dataclass(frozen=True)
class Fresh:
    """What is told of Γ, and what C is to be judged by."""

    quality: TransitionQuality
    labels: FreshLabels


def fresh_experience(
    scenes: Scenes, gamma: TransitionModel, tests: int, generator: Generator
) -> Fresh:
    """Γ on fresh transitions, and fresh labels for C, at most as many as `tests`.

    Where the world is costly there are fewer of both.
    """
    quality = transition_quality(scenes, gamma, FRESH_TRANSITIONS // scenes.thrift, generator)
    labels = min(FRESH_LABELS // scenes.thrift, tests)
    return Fresh(quality, fresh_labels(scenes, labels, generator))


def tabletop_summary(
    scenes: Scenes, knowledge: Knowledge, fresh: Fresh, generator: Generator
) -> ModelSummary:
    """The line, the numbers and the curves of the first models."""
    judged = success_quality(scenes, knowledge.classifier, fresh.labels, generator)
    error = dict(zip(knowledge.gamma_report.coordinates, knowledge.gamma_report.error, strict=True))
    scalars = {
        **scalars_of(knowledge),
        "gamma/object_error": (error["object x"] + error["object y"]) / 2,
        "classifier/near_calibration_error": judged.near.calibration_error,
    }
    for part in ("object", "table"):
        for kind in ("error", "floor"):
            scalars[f"gamma/fresh_{part}_{kind}"] = getattr(fresh.quality, f"{part}_{kind}")
    for name in ("near", "overall", "beside"):
        scalars[f"classifier/{name}_accuracy"] = getattr(judged, name).balanced
        scalars[f"classifier/{name}_possible"] = getattr(judged, name).possible_balanced
    text = f"{_on_fresh(fresh.quality)}, {_on_labels(judged)}; {rows_of(knowledge)}"
    basic = summary_of(knowledge)
    return replace(basic, text=text, scalars=scalars, reliability=judged.reliability)


def _on_labels(quality: SuccessQuality) -> str:
    """How good C is on fresh labels, beside the most that is possible."""
    draws = (("near the object", quality.near), ("overall", quality.overall))
    said = (
        f"{100 * one.balanced:.1f} % {where} (possible {100 * one.possible_balanced:.1f})"
        for where, one in draws
    )
    return f"C's balanced accuracy on fresh labels is {' and '.join(said)}"


def _on_fresh(quality: TransitionQuality) -> str:
    """Γ's errors on fresh transitions, each beside what no model can better."""
    return (
        f"on {quality.rows} fresh transitions Γ errs by {100 * quality.object_error:.2f} cm on the "
        f"object (floor {100 * quality.object_floor:.2f}; without the noise of the motion "
        f"{100 * quality.object_offset:.2f}) and {100 * quality.table_error:.2f} cm on the table "
        f"(floor {100 * quality.table_floor:.2f} ± {100 * quality.table_floor_error:.2f})"
    )
