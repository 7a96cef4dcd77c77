"""The quality of Γ and C, as rows of tables and pictures."""

from statistics import fmean
from typing import Any

from markupsafe import Markup

from cgtorch.domains.reports import TransitionReport
from cgtorch.report.html import inline_svg
from cgtorch.report.page.contents import Contents
from cgtorch.report.page.plots import Curve, draw_learning
from cgtorch.report.reliability_picture import draw_reliability
from cgtorch.svm import Choice

Rows = list[tuple[str, ...]]
SCORES = {
    "gamma": "Γ: − error of what it learns",
    "classifier": "C: balanced accuracy",
}


def model_quality(contents: Contents) -> dict[str, Any]:
    """The quality of the models from their reports, or else from the event files."""
    fitted, events = contents.fitted, contents.events
    learning, reliability = Markup(""), Markup("")
    if curves := _curves(contents):
        figure = draw_learning(curves)
        learning = inline_svg(figure, "learning", "Learning curves of the models")
    if fitted is not None and (bins := fitted.classifier.reliability):
        figure = draw_reliability(bins, title="C", of="held-out labels")
        reliability = inline_svg(figure, "reliability", "Reliability diagram of C")
    return {
        "fitted": fitted,
        "errors": _errors(contents),
        "choices": [] if fitted is None else _choices(fitted.gamma),
        "balanced": events.last("classifier/balanced_accuracy"),
        "seconds": [seconds for _, seconds in events.scalars.get("models/fit_seconds", ())],
        "learning": learning,
        "reliability": reliability,
    }


def _errors(contents: Contents) -> Rows:
    if contents.fitted is not None:
        report = contents.fitted.gamma
        errors = report.error, report.baseline_error
        rows = zip(report.coordinates, report.units, *errors, strict=True)
        return [(name, _in_unit(e, unit), _in_unit(rigid, unit)) for name, unit, e, rigid in rows]
    prefix = "gamma/error_"
    return [
        (tag.removeprefix(prefix).replace("_", " "), _cm(points[-1][1]), "–")
        for tag, points in contents.events.scalars.items()
        if tag.startswith(prefix)
    ]


def _choices(report: TransitionReport) -> list[tuple[str, Choice]]:
    """The hyper-parameters of each output that is learned, with what the output is about.

    That is not known if there are not as many outputs as numbers in a percept.
    """
    names = [f" for {name}" for name in report.coordinates]
    if len(names) != len(report.choice):
        names = [""] * len(report.choice)
    pairs = zip(names, report.choice, strict=True)
    return [(name, choice) for name, choice in pairs if choice is not None]


def _curves(contents: Contents) -> list[Curve]:
    if contents.fitted is None:
        scalars, curves = contents.by_rows.scalars, list[Curve]()
        for model, name in SCORES.items():
            kinds = (f"{model}/learning_curve/{kind}" for kind in ("train", "test"))
            train, test = (dict(scalars.get(tag, ())) for tag in kinds)
            if sizes := sorted(set(train) & set(test)):
                curves.append((name, sizes, [train[s] for s in sizes], [test[s] for s in sizes]))
        return curves
    found = (contents.fitted.gamma.learning_curve, contents.fitted.classifier.learning_curve)
    return [
        (name, curve.sizes, [*map(fmean, curve.train_scores)], [*map(fmean, curve.test_scores)])
        for name, curve in zip(SCORES.values(), found, strict=True)
        if curve is not None and curve.sizes
    ]


def _in_unit(value: float, unit: str) -> str:
    """An error in the unit of its number, with metres as centimetres."""
    return _cm(value) if unit == "m" else f"{value:.3g} {unit}".rstrip()


def _cm(metres: float) -> str:
    return f"{100 * metres:.2f} cm"
