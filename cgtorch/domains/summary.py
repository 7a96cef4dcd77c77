"""Summaries of models: the quality of the first ones, later whether new ones were accepted."""

from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.reports import TransitionReport
from cgtorch.ground.statistics import Acceptance
from cgtorch.improvement.events import ModelSummary

SHOWN = 6  # numbers of a percept whose errors are told in a line


def summary_of(knowledge: Knowledge) -> ModelSummary:
    """The results of cross-validation, or, after learning, whether new models were accepted."""
    rows = rows_of(knowledge)
    if knowledge.acceptances is not None:
        said = "; ".join(map(_learned, ("Γ", "C"), knowledge.acceptances))
        return ModelSummary(f"{said}; now from {rows}", {"models/rows": _moves(knowledge)})
    classifier = knowledge.classifier_report
    text = (
        f"Γ errs by {_errors(knowledge.gamma_report)}, "
        f"the balanced accuracy of C is {100 * classifier.balanced_accuracy:.1f} %; {rows}"
    )
    curves = {
        "gamma": knowledge.gamma_report.learning_curve,
        "classifier": classifier.learning_curve,
    }
    return ModelSummary(text, scalars_of(knowledge), curves, classifier.reliability, first=True)


def scalars_of(knowledge: Knowledge) -> dict[str, float]:
    """The results of cross-validation, by TensorBoard tags."""
    gamma, classifier = knowledge.gamma_report, knowledge.classifier_report
    errors = zip(gamma.coordinates, gamma.error, strict=True)
    return {
        "models/rows": _moves(knowledge),
        **{f"gamma/error_{name.replace(' ', '_')}": error for name, error in errors},
        "classifier/balanced_accuracy": classifier.balanced_accuracy,
        "classifier/calibration_error": classifier.calibration_error,
    }


def rows_of(knowledge: Knowledge) -> str:
    """The amount of data of the models, in words."""
    return f"{_moves(knowledge)} transitions and {len(knowledge.dataset.succeeded)} labels"


def _moves(knowledge: Knowledge) -> int:
    return len(knowledge.dataset.percept)


def _errors(report: TransitionReport) -> str:
    """Γ's cross-validated errors, sorted by their ratio to the error of a model without Γ."""
    rows = zip(report.error, report.baseline_error, report.coordinates, report.units, strict=True)
    worst = sorted(rows, key=lambda row: row[0] / row[1] if row[1] else 0.0, reverse=True)
    said = [f"{error:.2g}{f' {unit}' if unit else ''} on {name}" for error, _, name, unit in worst]
    more = f" and less on {len(said) - SHOWN} others (see TensorBoard)" if len(said) > SHOWN else ""
    return ", ".join(said[:SHOWN]) + more


def _learned(name: str, acceptance: Acceptance) -> str:
    """The decision about a model that was trained on more data."""
    if acceptance.accepted:
        return f"{name} was trained on more data"
    return (
        f"{name} stays as it was, since its error on earlier data would be "
        f"{acceptance.after:.4f} instead of {acceptance.before:.4f}"
    )
