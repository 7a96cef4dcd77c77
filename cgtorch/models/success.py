"""C, the success classifier: the probability that a skill succeeds from a percept."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor, nn

from cgtorch.errors import DataError
from cgtorch.models import inputs
from cgtorch.models.compiled import Compiled, classifier_structure, successes
from cgtorch.models.grasp_features import (
    FLAT,
    SIZES,
    compiled_features,
    grasp_features,
    used_features,
)
from cgtorch.models.grid_search import Choice, Progress, grid_search
from cgtorch.models.learning_curve import LearningCurve, doubling_sizes, learning_values
from cgtorch.models.platt import fit_platt, probability
from cgtorch.models.scores import balanced_accuracy
from cgtorch.models.svc import SVC, ClassWeight
from cgtorch.native.structures import suits

C_GRID = (100.0, 300.0)
GAMMA_GRID = (0.5, 1.0, 2.0)
GRID_ROWS = 1000
_FEWEST = 10  # rows of the smaller class that a point of the learning curve learns from


Reliability: TypeAlias = tuple[tuple[float, float, int], ...]
"""Mean probability, frequency of success and number of rows of bins of probability."""


@dataclass(frozen=True)
class SuccessReport:
    """What the fit of a success classifier found.

    Attributes:
        rows: Labelled percepts it learnt from.
        positive: Share of them that succeed.
        balanced_accuracy: Cross-validated, of all rows at the chosen cell.
        brier: Mean squared difference of cross-validated probability and label.
        calibration_error: Mean gap between probability and frequency over 10 equal bins,
            weighted by their rows.
        reliability: Mean probability, frequency and rows of each bin that is not empty.
        choice: Hyper-parameters.
        gap: Duality gap.
        centres: Number of centres.
        grid_cost: Costs tried.
        grid_gamma: Kernel widths tried.
        grid_scores: Mean balanced accuracy by gamma and C.
        finished_by_smo: Cells of the grid that the active set left to SMO.
        learning_curve: Balanced accuracy of the chosen cell by rows learnt from.
    """

    rows: int
    positive: float
    balanced_accuracy: float
    brier: float
    calibration_error: float
    reliability: Reliability
    choice: Choice
    gap: float
    centres: int
    grid_cost: tuple[float, ...]
    grid_gamma: tuple[float, ...]
    grid_scores: list[Any]
    finished_by_smo: int
    learning_curve: LearningCurve


class SuccessClassifier(nn.Module):
    """C: percept (..., D) -> probability of success (...), differentiable in the percept.

    Buffers: the features' `mean` (F,) and common `scale` (F,); the machine's are in `machine`.
    """

    mean: Tensor
    scale: Tensor
    machine: SVC

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(0, dtype=torch.float64))
        self.register_buffer("scale", torch.ones(0, dtype=torch.float64))
        self.machine = SVC()

    def forward(self, percept: Tensor) -> Tensor:
        """Probability (...) that the skill succeeds.

        Raises:
            DataError: Another number of coordinates than it was fitted on.
            ModelError: Not fitted.
        """
        compiled = self.compiled(percept)
        if compiled is not None:
            found = successes(compiled, percept.reshape(-1, percept.shape[-1]))
            if found is not None:
                return found.view(percept.shape[:-1])
        return self.predict_in_torch(percept)

    def predict_in_torch(self, percept: Tensor) -> Tensor:
        """What `forward` says (n,) of percepts (n, D), on any device and with gradients."""
        return self.machine(self.features(percept)).to(percept.dtype)

    def compiled(self, percept: Tensor) -> Compiled | None:
        """C as compiled code knows it, where that can be asked about percepts (n, D)."""
        machine, mean, scale, platt = self.machine._machine, *self.tensors()[4:]
        suited = suits(percept, *self.tensors())
        if not suited or self.machine.kernel != "rbf" or not self.machine.fitted:
            return None
        if not compiled_features(percept.shape[-1], len(mean)):
            return None
        return classifier_structure(machine, mean, scale, platt)

    def tensors(self) -> tuple[Tensor, ...]:
        """Centres (m, F), weights (m, 1), bias (1,), γ (), mean (F,), scale (F,), Platt's (2,)."""
        return *self.machine._machine, self.mean, self.scale, self.machine.platt

    def decision_function(self, percept: Tensor) -> Tensor:
        """Signed decision value (...), positive for success."""
        return self.machine.values(self.features(percept))[..., 0].to(percept.dtype)

    def features(self, percept: Tensor) -> Tensor:
        """The standardised features (..., F) that the machine sees."""
        self.machine._check_fitted()
        features, used = grasp_features(percept.to(self.mean)), len(self.mean)
        flat = used == FLAT and features.shape[-1] == FLAT + 1 and percept.shape[-1] in SIZES
        if features.shape[-1] != used and not flat:
            raise DataError(
                f"a percept has {percept.shape[-1]} coordinates, which make {features.shape[-1]} "
                f"features; the classifier was fitted on {used}"
            )
        return (features[..., :used] - self.mean) / self.scale

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        for name in ("mean", "scale"):
            given = state_dict.get(prefix + name)
            if isinstance(given, Tensor) and given.ndim == 1:
                self._buffers[name] = self.mean.new_zeros(given.shape)
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)


def fit_success_classifier(
    percept: Any,
    label: Any,
    *,
    seed: int | torch.Generator = 0,
    folds: int = 5,
    C: Sequence[float] = C_GRID,
    gamma: Sequence[float] = GAMMA_GRID,
    grid_rows: int | None = GRID_ROWS,
    class_weight: ClassWeight = None,
    progress: Progress | None = None,
    max_memory: int = inputs.MAX_MEMORY,
    dtype: torch.dtype = torch.float32,
) -> tuple[SuccessClassifier, SuccessReport]:
    """Choose the hyper-parameters by cross-validation and fit C on all labels.

    Args:
        percept: Percepts (n, D), m.
        label: True or 1 where the skill succeeded (n,).
        seed: Seed or generator of folds, subset and solver.
        folds: Number of stratified folds, for the grid and for Platt's probabilities.
        C: Costs to try.
        gamma: Kernel widths to try, on scaled features.
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
    model, features = _standardised(rows)
    order = _mixed_order(signs, generator)  # whose first rows are a sample of all
    mixed, truth = features[order], signs[order]
    grid = grid_search(
        SVC(class_weight=class_weight, max_memory=max_memory),
        mixed[:grid_rows],
        truth[:grid_rows],
        C=C,
        gamma=gamma,
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
        finished_by_smo=int((~grid.direct).sum()),
        learning_curve=curve.scored("balanced_accuracy"),
    )
    return model.to(dtype), report


def _standardised(rows: Tensor) -> tuple[SuccessClassifier, Tensor]:
    """A classifier that has no machine yet, and the features (n, F) of percepts (n, D).

    One scale for all features: they are lengths and weighed so that they matter about as much, and
    what hardly varies is hardly more than noise, which a scale of its own would blow up.
    """
    features = grasp_features(rows)[:, : used_features(rows)]
    model = SuccessClassifier().to(rows.device)
    model.mean = features.mean(0)
    spread = features.var(0, correction=0).mean().sqrt()
    model.scale = torch.where(spread > 0, spread, 1.0).expand_as(model.mean).clone()
    return model, (features - model.mean) / model.scale


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
