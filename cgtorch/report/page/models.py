"""How good Γ and C are, as tables and pictures."""

from dataclasses import dataclass

from markupsafe import Markup
from matplotlib import rc_context

from cgtorch.report.html import STYLE, inline_svg
from cgtorch.report.page.contents import Contents
from cgtorch.report.page.event_files import Told
from cgtorch.report.page.plots import Curve, draw_learning
from cgtorch.report.reliability_picture import draw_reliability

Row = tuple[str, ...]
DRAWS = {
    "near": "near the object, any side and heading",
    "overall": "anywhere around the table",
    "beside": "just across the boundary of what can be grasped",
}
FRESH = {"object": "the object, x and y", "table": "the table's sides"}
SCORES = {
    "gamma": "Γ: − error of what it learns",
    "classifier": "C: balanced accuracy",
}


@dataclass(frozen=True)
class ModelQuality:
    """What the page says of Γ and C; a table without rows is left out.

    Attributes:
        where: the folder of the run that has the models; None if none has.
        errors: of Γ by coordinate, cross-validated.
        fresh: of Γ on fresh transitions, beside the least possible.
        accuracy: of C on fresh labels, beside the most possible.
        facts: names and values.
        learning: the learning curves.
        reliability: C's probabilities against frequencies.
    """

    where: str | None
    errors: tuple[Row, ...]
    fresh: tuple[Row, ...]
    accuracy: tuple[Row, ...]
    facts: tuple[Row, ...]
    learning: Markup
    reliability: Markup

    def __bool__(self) -> bool:
        """Whether anything is known."""
        return bool(self.errors or self.fresh or self.accuracy or self.facts)


def model_quality(contents: Contents) -> ModelQuality:
    """From the reports of the models where the run has them, else from its event files."""
    fitted, told = contents.fitted, contents.told
    curves = _curves(contents)
    learning, reliability = Markup(""), Markup("")
    with rc_context(STYLE):
        if curves:
            figure = draw_learning(curves)
            learning = inline_svg(figure, "learning", "Learning curves of the models")
        if fitted is not None and fitted.classifier.reliability:
            bins = tuple((m, f, int(n)) for m, f, n in fitted.classifier.reliability)
            figure = draw_reliability(bins, title="C", of="held-out labels")
            reliability = inline_svg(figure, "reliability", "Reliability diagram of C")
    return ModelQuality(
        None if fitted is None else fitted.where,
        _errors(contents),
        tuple(_fresh(told)),
        tuple(_accuracy(told)),
        tuple(_facts(contents)),
        learning,
        reliability,
    )


def _errors(contents: Contents) -> tuple[Row, ...]:
    if contents.fitted is not None:
        report = contents.fitted.gamma
        rows = zip(
            report.coordinates, report.units, report.error, report.baseline_error, strict=True
        )
        return tuple(
            (name, _in_unit(error, unit), _in_unit(rigid, unit))
            for name, unit, error, rigid in rows
        )
    prefix = "gamma/error_"
    tags = [tag for tag in contents.told.scalars if tag.startswith(prefix)]
    return tuple(
        (tag.removeprefix(prefix).replace("_", " "), _cm(value), "–")
        for tag in tags
        if (value := contents.told.last(tag)) is not None
    )


def _fresh(told: Told) -> list[Row]:
    rows: list[Row] = []
    for part, words in FRESH.items():
        error, floor = (told.last(f"gamma/fresh_{part}_{kind}") for kind in ("error", "floor"))
        if error is not None and floor is not None:
            rows.append((words, _cm(error), _cm(floor)))
    return rows


def _accuracy(told: Told) -> list[Row]:
    rows: list[Row] = []
    for draw, words in DRAWS.items():
        right, most = (told.last(f"classifier/{draw}_{kind}") for kind in ("accuracy", "possible"))
        if right is not None and most is not None:
            rows.append((words, f"{right:.1%}", f"{most:.1%}"))
    return rows


def _facts(contents: Contents) -> list[Row]:
    fitted, told = contents.fitted, contents.told
    rows: list[Row] = []
    if fitted is not None:
        gamma, classifier = fitted.gamma, fitted.classifier
        rows = [
            (
                "Γ: transitions learnt from",
                f"{gamma.rows}, {gamma.informative} of them tell what is to be learned",
            ),
            ("Γ: centres", f"{gamma.centres}"),
            *(
                ("Γ: C, γ, ε chosen", f"{c.C:g}, {c.gamma:g}, {c.epsilon:g}")
                for c in gamma.choice
                if c is not None
            ),
            (
                "C: labels learnt from",
                f"{classifier.rows}, {classifier.positive:.0%} of them successes",
            ),
            ("C: centres", f"{classifier.centres}"),
            ("C: C, γ chosen", f"{classifier.choice.C:g}, {classifier.choice.gamma:g}"),
            ("C: balanced accuracy, cross-validated", f"{classifier.balanced_accuracy:.1%}"),
            ("C: Brier score, cross-validated", f"{classifier.brier:.4f}"),
            ("C: calibration error, cross-validated", f"{classifier.calibration_error:.4f}"),
        ]
    elif (right := told.last("classifier/balanced_accuracy")) is not None:
        rows.append(("C: balanced accuracy, cross-validated", f"{right:.1%}"))
    times = [seconds for _, seconds in told.scalars.get("models/fit_seconds", ())]
    if times:
        rows.append(("Fits of Γ and C", f"{len(times)}, {sum(times):.1f} s in all"))
    return rows


def _curves(contents: Contents) -> list[Curve]:
    fitted = contents.fitted
    if fitted is None:
        return [
            (name, *_columns(contents.by_rows, model))
            for model, name in SCORES.items()
            if contents.by_rows.scalars.get(f"{model}/learning_curve/test")
        ]
    found = (fitted.gamma.learning_curve, fitted.classifier.learning_curve)
    return [
        (name, curve.sizes, _means(curve.train_scores), _means(curve.test_scores))
        for name, curve in zip(SCORES.values(), found, strict=True)
        if curve is not None and curve.sizes
    ]


def _columns(told: Told, model: str) -> tuple[list[float], list[float], list[float]]:
    train, test = (
        dict(told.scalars.get(f"{model}/learning_curve/{kind}", ())) for kind in ("train", "test")
    )
    sizes = sorted(set(train) & set(test))
    return [*map(float, sizes)], [train[s] for s in sizes], [test[s] for s in sizes]


def _means(scores: tuple[tuple[float, ...], ...]) -> list[float]:
    return [sum(of_folds) / len(of_folds) for of_folds in scores]


def _in_unit(value: float, unit: str) -> str:
    """An error in the unit of its number; metres as centimetres."""
    return _cm(value) if unit == "m" else f"{value:.3g} {unit}".rstrip()


def _cm(metres: float) -> str:
    return f"{100 * metres:.2f} cm"
