"""C, the success classifier: the probability that a skill succeeds from a percept.

`SuccessClassifier` works for any domain. It is a support vector classifier on the standardised
numbers of a percept, with sine and cosine of angles. A domain can override its features.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.learned_model import LearnedModel, mean_and_spread
from cgtorch.domains.reports import Reliability, SuccessReport
from cgtorch.ground.fields import Field, as_features
from cgtorch.svm import SVC, doubling_sizes, grid_search, inputs, learning_values
from cgtorch.svm.cross_validation import balanced_accuracy, stratified_folds, training_masks
from cgtorch.svm.platt import fit_platt, probability

C_GRID = (1.0, 10.0, 100.0, 1000.0)
GAMMA_GRID = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Kernel widths for one feature; they are divided by the number of features."""
GRID_ROWS = 1000
FOLDS = 5  # of cross-validation; fewer if the rarer label has fewer rows
_FEWEST = 10  # rows of the smaller class that a point of the learning curve learns from


class SuccessClassifier(LearnedModel):
    """C: percept (..., D) -> probability of success (...), differentiable in the percept."""

    machine: SVC

    def __init__(
        self,
        percept: Sequence[Field] = (),
        further: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        """An unfitted C for percepts, with additional features (..., F) if given."""
        super().__init__(SVC())
        self.percept_fields, self.further = tuple(percept), further

    def forward(self, percept: Tensor) -> Tensor:
        """Probability (...) of success; DataError for another D, ModelError if not fitted."""
        return self.predict_in_torch(percept)

    def predict_in_torch(self, percept: Tensor) -> Tensor:
        """The result of `forward` (n,) for percepts (n, D), on any device and with gradients."""
        return self.machine(self.features(percept)).to(percept.dtype)

    def decision_function(self, percept: Tensor) -> Tensor:
        """Signed decision value (...), positive for success."""
        return self.machine.values(self.features(percept))[..., 0].to(percept.dtype)

    def raw_features(self, percept: Tensor) -> Tensor:
        """The features (..., F) before they are standardised."""
        seen = as_features(percept, self.percept_fields)
        return seen if self.further is None else torch.cat([seen, self.further(percept)], -1)

    def features(self, percept: Tensor) -> Tensor:
        """The standardised features (..., F), the input of the machine."""
        self.machine.check_fitted()
        made_of = f"a percept has {percept.shape[-1]} coordinates, which"
        return self.standardised(self.raw_features(percept.to(self.mean)), made_of)

    def standardise(self, percept: Tensor) -> Tensor:
        """Learn the scale of features from percepts (n, D), and return them standardised (n, F)."""
        raw = self.raw_features(percept)
        self.mean, self.scale = mean_and_spread(raw)
        return (raw - self.mean) / self.scale

    def checked(self, *rows: Any) -> tuple[Tensor, ...]:
        """See `LearnedModel.checked`: percepts (n, D), and -1 and 1 for labels (n,)."""
        percept, label = rows
        seen = inputs.as_rows(percept, "percept")
        inputs.check_memory(len(seen))
        return seen, inputs.as_binary(label, len(seen))[1].to(seen)

    def learnable(self, *rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """See `LearnedModel.learnable`; every percept is informative."""
        percept, label = rows
        return self.features(percept), label, torch.ones_like(label, dtype=torch.bool)

    def loss(self, *rows: Tensor) -> Tensor:
        """See `LearnedModel.loss`: the Brier score."""
        percept, label = rows
        return (self(percept) - label.float()).square()


def fit_success_classifier(
    model: SuccessClassifier,
    percept: Any,
    label: Any,
    *,
    seed: int | torch.Generator = 0,
    C: Sequence[float] = C_GRID,
    gamma: Sequence[float] | None = None,
    grid_rows: int = GRID_ROWS,
    dtype: torch.dtype = torch.float32,
) -> tuple[SuccessClassifier, SuccessReport]:
    """Choose the hyper-parameters by cross-validation and fit C to all labels, in place.

    Args:
        model: The classifier.
        percept: (n, D) percepts.
        label: (n,) True or 1 where the skill succeeded.
        seed: A seed, or a generator.
        C: The costs in the grid.
        gamma: The kernel widths in the grid, for scaled features; `GAMMA_GRID` by default.
        grid_rows: Number of random rows on which the grid is scored.
        dtype: The type of the model's buffers.

    Raises:
        DataError: Wrong shapes, NaN, one class only, too few rows or too many.
        SettingsError: A grid that cannot be used.
    """
    rows, signs = model.checked(percept, label)
    generator = inputs.generator_of(seed)
    features = model.to(rows.device).standardise(rows)
    order = _mixed_order(signs, generator)  # whose first rows are a sample of all
    rarer = int(torch.minimum((signs > 0).sum(), (signs < 0).sum()))
    if rarer * min(1.0, grid_rows / len(rows)) < _FEWEST:  # whose first rows may have one class
        rare = signs[order] * signs.sum() < 0
        order = torch.cat([order[rare], order[~rare]])
    mixed, truth = features[order], signs[order]
    folds = max(2, min(FOLDS, rarer))
    widths = gamma or [each / features.shape[1] for each in GAMMA_GRID]
    grid = grid_search(
        SVC(), mixed[:grid_rows], truth[:grid_rows], C=C, gamma=widths, folds=folds,
        seed=generator, scoring="balanced_accuracy",
    )  # fmt: skip
    best = grid.best[0]
    machine = SVC(best.C, gamma=best.gamma)
    fewest = _FEWEST * len(rows) / max(1, rarer)
    numbers = stratified_folds(truth, folds, generator)
    largest = int(training_masks(numbers).sum(1).min())  # so that few rows of a class are in each
    smaller = doubling_sizes(len(rows), folds)[:-1]
    sizes = [*(size for size in smaller if size >= fewest), largest]
    curve = learning_values(machine, mixed, truth, sizes=sizes, folds=numbers)
    value = curve.held_out[0]
    chance = _cross_fitted(value, truth, curve.folds)
    happened = (truth > 0).to(chance)
    error, reliability = calibration(chance, happened)
    model.machine = machine.fit(features, signs)
    model.machine.platt = torch.stack(fit_platt(value, truth)).to(features)
    report = SuccessReport(
        rows=len(rows),
        positive=float(happened.mean()),
        balanced_accuracy=float(balanced_accuracy(value, truth)),
        brier=float((chance - happened).square().mean()),
        calibration_error=error,
        reliability=reliability,
        choice=best,
        gap=float(model.machine.gap[0]),
        centres=len(model.machine.centres),
        grid_cost=tuple(grid.C.tolist()),
        grid_gamma=tuple(grid.gamma.tolist()),
        grid_scores=grid.mean[:, 0, :, 0].tolist(),
        learning_curve=curve.scored("balanced_accuracy"),
    )
    return model.to(dtype), report


def _mixed_order(signs: Tensor, generator: torch.Generator) -> Tensor:
    """A random order (n,) in which every prefix has the two classes in proportion."""
    place = torch.rand(len(signs), generator=generator).to(signs)
    for sign in (-1, 1):
        rows = (signs == sign).nonzero()[:, 0]
        shuffled = rows[place[rows].argsort()]
        place[shuffled] = (torch.arange(len(rows)).to(signs) + 0.5) / len(rows)
    return place.argsort()


def _cross_fitted(value: Tensor, signs: Tensor, folds: Tensor) -> Tensor:
    """Probabilities (n,) of held-out values, with each fold's Platt curve fitted to the others."""
    chance = torch.zeros_like(value)
    for number in folds.unique():
        inside = folds == number
        slope, offset = fit_platt(value[~inside], signs[~inside])
        chance[inside] = probability(value[inside], slope, offset)
    return chance


def calibration(chance: Tensor, truth: Tensor, bins: int = 10) -> tuple[float, Reliability]:
    """Expected calibration error and reliability curve of probabilities (n,) (Naeini 2015).

    `truth` (n,) is 1 for success, else 0. The bins are equally wide.
    """
    number = (chance * bins).long().clamp(0, bins - 1)
    curve = []
    error = 0.0
    for index in number.unique():
        inside = number == index
        mean, frequency = float(chance[inside].mean()), float(truth[inside].mean())
        curve.append((mean, frequency, int(inside.sum())))
        error += abs(mean - frequency) * int(inside.sum()) / len(chance)
    return error, tuple(curve)
