"""C, the success classifier: the probability that a skill succeeds from a percept.

`SuccessClassifier` is that of any domain: a support vector classifier on the standardised numbers
of a percept, angles by sine and cosine. A domain that knows more overrides its features.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from cgtorch.domains.reports import Reliability, SuccessReport
from cgtorch.environment.fields import Field, as_features
from cgtorch.ground.errors import DataError
from cgtorch.svm import SVC, doubling_sizes, grid_search, inputs
from cgtorch.svm.grid_search import Progress
from cgtorch.svm.learning_curve import learning_values
from cgtorch.svm.platt import fit_platt, probability
from cgtorch.svm.scores import balanced_accuracy
from cgtorch.svm.svc import ClassWeight

C_GRID = (1.0, 10.0, 100.0, 1000.0)
GAMMA_GRID = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Kernel widths for one feature; divided by the number of features."""
GRID_ROWS = 1000
_FEWEST = 10  # rows of the smaller class that a point of the learning curve learns from


class SuccessClassifier(nn.Module):
    """C: percept (..., D) -> probability of success (...), differentiable in the percept.

    Buffers: the features' `mean` and `scale` (F,); the machine's are in `machine`.
    """

    mean: Tensor
    scale: Tensor
    machine: SVC

    def __init__(
        self,
        percept: Sequence[Field] = (),
        further: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        """An unfitted C.

        Args:
            percept: the D numbers of a percept.
            further: from percepts (..., D) to features (..., F) that the machine sees besides.
        """
        super().__init__()
        self.percept_fields, self.further = tuple(percept), further
        self.register_buffer("mean", torch.zeros(0, dtype=torch.float64))
        self.register_buffer("scale", torch.ones(0, dtype=torch.float64))
        self.machine = SVC()

    def forward(self, percept: Tensor) -> Tensor:
        """Probability (...) that the skill succeeds.

        Raises:
            DataError: Another number of coordinates than it was fitted on.
            ModelError: Not fitted.
        """
        return self.predict_in_torch(percept)

    def predict_in_torch(self, percept: Tensor) -> Tensor:
        """What `forward` says (n,) of percepts (n, D), on any device and with gradients."""
        return self.machine(self.features(percept)).to(percept.dtype)

    def decision_function(self, percept: Tensor) -> Tensor:
        """Signed decision value (...), positive for success."""
        return self.machine.values(self.features(percept))[..., 0].to(percept.dtype)

    def raw_features(self, percept: Tensor) -> Tensor:
        """The features (..., F) before they are standardised."""
        seen = as_features(percept, self.percept_fields)
        return seen if self.further is None else torch.cat([seen, self.further(percept)], -1)

    def features(self, percept: Tensor) -> Tensor:
        """The standardised features (..., F) that the machine sees."""
        self.machine._check_fitted()
        raw = self.raw_features(percept.to(self.mean))
        if raw.shape[-1] != len(self.mean):
            raise DataError(
                f"a percept has {percept.shape[-1]} coordinates, which make {raw.shape[-1]} "
                f"features; the classifier was fitted on {len(self.mean)}"
            )
        return (raw - self.mean) / self.scale

    def standardise(self, percept: Tensor) -> Tensor:
        """Learn the scale of the features from percepts (n, D), and standardise these (n, F)."""
        raw = self.raw_features(percept)
        spread = raw.std(0, correction=0)
        self.mean = raw.mean(0)
        self.scale = torch.where(spread > 1e-9 * (1 + raw.abs().amax(0)), spread, 1.0)
        return (raw - self.mean) / self.scale

    def shapes(self, features: int) -> dict[str, tuple[int, ...]]:
        """The shapes of the buffers, but for the machine's, given F; files are checked by them."""
        return dict.fromkeys(("mean", "scale"), (features,))

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        for name in ("mean", "scale"):
            given = state_dict.get(prefix + name)
            if isinstance(given, Tensor) and given.ndim == 1:
                self._buffers[name] = self.mean.new_zeros(given.shape)
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)


def fit_success_classifier(
    model: SuccessClassifier,
    percept: Any,
    label: Any,
    *,
    seed: int | torch.Generator = 0,
    folds: int = 5,
    C: Sequence[float] = C_GRID,
    gamma: Sequence[float] | None = None,
    grid_rows: int | None = GRID_ROWS,
    class_weight: ClassWeight = None,
    progress: Progress | None = None,
    max_memory: int = inputs.MAX_MEMORY,
    dtype: torch.dtype = torch.float32,
) -> tuple[SuccessClassifier, SuccessReport]:
    """Choose the hyper-parameters by cross-validation and fit C on all labels, in place.

    Args:
        model: An unfitted C.
        percept: Percepts (n, D).
        label: True or 1 where the skill succeeded (n,).
        seed: Seed or generator of folds, subset and solver.
        folds: Number of stratified folds, for the grid and for Platt's probabilities.
        C: Costs to try.
        gamma: Kernel widths to try, on scaled features; `GAMMA_GRID` for F of them if not given.
        grid_rows: Random rows that the grid is scored on, None for all.
        class_weight: None, "balanced", or a factor on C per class.
        progress: Called with (cells done, all cells).
        max_memory: Bytes that kernel matrices may take.
        dtype: Type of the returned model's buffers.

    Returns:
        The model and the report.

    Raises:
        DataError: Wrong shapes, NaN, one class only, too few rows or too many.
        SettingsError: A grid that cannot be used.
    """
    rows = inputs.as_rows(percept, "percept")
    _, signs = inputs.as_binary(label, len(rows))
    signs = signs.to(rows)
    inputs.check_memory(len(rows), max_memory)
    generator = inputs.generator_of(seed)
    features = model.to(rows.device).standardise(rows)
    order = _mixed_order(signs, generator)  # whose first rows are a sample of all
    mixed, truth = features[order], signs[order]
    grid = grid_search(
        SVC(class_weight=class_weight, max_memory=max_memory),
        mixed[:grid_rows],
        truth[:grid_rows],
        C=C,
        gamma=gamma or [each / features.shape[1] for each in GAMMA_GRID],
        folds=folds,
        seed=generator,
        scoring="balanced_accuracy",
        progress=progress,
    )
    best = grid.best[0]
    machine = SVC(
        best.C, gamma=best.gamma, class_weight=class_weight, seed=generator, max_memory=max_memory
    )
    fewest = _FEWEST * len(rows) / float(torch.minimum((signs > 0).sum(), (signs < 0).sum()))
    sizes = [size for size in doubling_sizes(len(rows), folds) if size >= fewest]
    sizes = sizes or [doubling_sizes(len(rows), folds)[-1]]
    curve = learning_values(machine, mixed, truth, sizes=sizes, folds=folds, seed=generator)
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
    """A random order (n,) in which any first rows hold the two classes in proportion."""
    place = torch.rand(len(signs), generator=generator).to(signs)
    for sign in (-1, 1):
        rows = (signs == sign).nonzero()[:, 0]
        shuffled = rows[place[rows].argsort()]
        place[shuffled] = (torch.arange(len(rows)).to(signs) + 0.5) / len(rows)
    return place.argsort()


def _cross_fitted(value: Tensor, signs: Tensor, folds: Tensor) -> Tensor:
    """Probabilities (n,) of held-out values, each fold's Platt curve fitted on the others."""
    chance = torch.zeros_like(value)
    for number in folds.unique():
        inside = folds == number
        slope, offset = fit_platt(value[~inside], signs[~inside])
        chance[inside] = probability(value[inside], slope, offset)
    return chance


def calibration(chance: Tensor, truth: Tensor, bins: int = 10) -> tuple[float, Reliability]:
    """Expected calibration error and the reliability curve of probabilities (n,) (Naeini 2015).

    Args:
        chance: Probabilities (n,).
        truth: 1 where it came true, else 0 (n,).
        bins: Number of equal bins.

    Returns:
        The error, and (mean probability, frequency, rows) of each bin that is not empty.
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
