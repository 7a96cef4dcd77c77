"""The quality of the tabletop's first Γ and C, each beside the best possible."""

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
FRESH_LABELS = 250  # at most, as many as were learnt from


@dataclass(frozen=True)
class Fresh:
    """The quality of Γ, and the fresh labels for C."""

    quality: TransitionQuality
    labels: FreshLabels


def fresh_experience(
    scenes: Scenes, gamma: TransitionModel, tests: int, generator: Generator
) -> Fresh:
    """The quality of Γ on fresh transitions, and at most `tests` fresh labels for C.

    There are fewer of both if the world is costly.
    """
    quality = transition_quality(scenes, gamma, FRESH_TRANSITIONS // scenes.thrift, generator)
    labels = min(FRESH_LABELS // scenes.thrift, tests)
    return Fresh(quality, fresh_labels(scenes, labels, generator))


def tabletop_summary(
    scenes: Scenes, knowledge: Knowledge, fresh: Fresh, generator: Generator
) -> ModelSummary:
    """The message, the numbers and the curves of the first models."""
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
    text = f"{_on_fresh(fresh.quality)}; {_on_labels(judged)}; {rows_of(knowledge)}"
    basic = summary_of(knowledge)
    return replace(basic, text=text, scalars=scalars, reliability=judged.reliability)


def _on_labels(quality: SuccessQuality) -> str:
    """The quality of C on fresh labels, beside the best possible."""
    draws = (("near the object", quality.near), ("overall", quality.overall))
    said = (
        f"{100 * one.balanced:.1f} % {where} (at best {100 * one.possible_balanced:.1f} %)"
        for where, one in draws
    )
    return f"the balanced accuracy of C on fresh labels is {' and '.join(said)}"


def _on_fresh(quality: TransitionQuality) -> str:
    """The errors of Γ on fresh transitions, beside the least possible ones."""
    return (
        f"the mean error of Γ on {quality.rows} fresh transitions is "
        f"{100 * quality.object_error:.2f} cm for the object (at best "
        f"{100 * quality.object_floor:.2f} cm because of noise; {100 * quality.object_offset:.2f} "
        f"cm without noise) and {100 * quality.table_error:.2f} cm for the sides of the table "
        f"(at best {100 * quality.table_floor:.2f} ± {100 * quality.table_floor_error:.2f} cm)"
    )
