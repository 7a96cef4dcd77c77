"""Γ, the transition model: the next percept from a percept and a control.

`TransitionModel` is the interface of every Γ. `KernelTransitionModel` works for any domain and
needs only the fields of its percepts and controls.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.domains.learned_model import LearnedModel, mean_and_spread
from cgtorch.ground.errors import DataError
from cgtorch.ground.fields import Field, as_features, columns_of, within_bounds, wrapped
from cgtorch.svm import SVR, fit_reduced_set, inputs

_NOVEL_SHARE = 0.1  # beyond the data by this share of their range counts as half novel
LN2 = math.log(2)

Features: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps percepts (..., D) and controls (..., U) to additional features (..., F)."""


@dataclass(frozen=True)
class Grid:
    """The grid of hyper-parameters of the cross-validation.

    Attributes:
        C: Costs, for standardised targets.
        gamma: Kernel widths for one feature; they are divided by the number of features.
        epsilon: Half widths of the tube, for standardised targets.
        rows: Maximum number of random rows in the cross-validation.
    """

    C: Sequence[float]
    gamma: Sequence[float]
    epsilon: Sequence[float]
    rows: int


@dataclass(frozen=True)
class HeldOut:
    """Predictions of machines for m rows that they had not learned from.

    Attributes:
        tells: (n,) bool, which of all rows are informative.
        value: (m, K) the predictions; `target` (m, K) are the true values.
        learnt: (K,) bool, the outputs for which the machine is better than none.
    """

    tells: Tensor
    value: Tensor
    target: Tensor
    learnt: Tensor


class TransitionModel(LearnedModel):
    """Γ: (percept (..., D), control (..., U)) -> next percept (..., D).

    Additional buffers are `reach` (), the squared feature distance that counts as half novel, and
    `most` (E,), the largest extremes of the data.
    """

    reach: Tensor
    most: Tensor
    machine: SVR
    grid: ClassVar[Grid]

    def __init__(self) -> None:
        super().__init__(SVR())
        self.register_buffer("most", torch.empty(0, dtype=torch.float64))
        self.register_buffer("reach", torch.ones((), dtype=torch.float64))

    @abstractmethod
    def features(self, percept: Tensor, control: Tensor) -> Tensor:
        """The standardised features (..., F), the input of the machine."""

    @abstractmethod
    def next_percept(self, percept: Tensor, control: Tensor, value: Tensor) -> Tensor:
        """Next percepts (..., D), given the machine's output `value` (..., K)."""

    @abstractmethod
    def extremes(self, percept: Tensor, control: Tensor) -> Tensor:
        """How extreme transitions are (..., E), at least 0, in the order of `most`."""

    @abstractmethod
    def targets(
        self, percept: Tensor, control: Tensor, next_percept: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Targets of the machine (n, K) for transitions, and (n,) bool, which are informative."""

    @abstractmethod
    def fields(self, size: int) -> Sequence[Field]:
        """The D fields of percepts of a size, with names and units."""

    @abstractmethod
    def standardise(
        self, percept: Tensor, control: Tensor, next_percept: Tensor, dtype: torch.dtype
    ) -> None:
        """Learn the scales from transitions (n, ...), for a model of type `dtype`."""

    @abstractmethod
    def settle(self, rows: Sequence[Tensor], held: HeldOut) -> tuple[Tensor, Tensor]:
        """Drop outputs that were not learnt; held-out errors (D,), and those without a machine."""

    def held_out(self, machine: SVR, x: Tensor, y: Tensor, generator: Generator) -> Tensor | None:
        """Held-out values (n, K) for all features x (n, F), or None to use those of the grid."""
        return None

    def forward(self, percept: Tensor, control: Tensor) -> Tensor:
        """Next percept (..., D); DataError for wrong shapes, ModelError if not fitted."""
        return self.predict_with_novelty(percept, control)[0]

    def novelty(self, percept: Tensor, control: Tensor) -> Tensor:
        """Distance (...) from the data: 0 at a centre, 1/2 at the edge of the data, 1 far away."""
        return self.predict_with_novelty(percept, control)[1]

    def predict_with_novelty(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """Next percept (..., D) and novelty (...), from one kernel evaluation; see `forward`."""
        return self.predict_in_torch(percept, control)

    def predict_in_torch(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """The result of `predict_with_novelty`, on any device and with gradients."""
        self.machine.check_fitted()
        value, distance = self.machine.values_and_distance(self.features(percept, control))
        after = self.next_percept(percept, control, value.to(percept))
        return after, self.novelty_of(self.extremes(percept, control), distance).to(percept)

    def novelty_of(self, extremes: Tensor, distance: Tensor) -> Tensor:
        """Novelty (...) of extremes (..., E) and squared distances (...) to the nearest centre."""
        # By how much it exceeds the data, 1 where that is half novel.
        beyond = (extremes / self.most.to(extremes) - 1).clamp_min(0).sum(-1)
        exponent = distance / self.reach + beyond.to(distance) / _NOVEL_SHARE
        return 1 - torch.exp(-LN2 * exponent)

    def difference(self, predicted: Tensor, seen: Tensor) -> Tensor:
        """The difference (n, D) between observed and predicted percepts (n, D)."""
        return seen - predicted

    def errors(self, predicted: Tensor, seen: Tensor) -> Tensor:
        """The errors (n,) of predictions (n, D), in the unit by which models are compared."""
        return self.difference(predicted, seen).abs().mean(1)

    def checked(self, *rows: Any) -> tuple[Tensor, ...]:
        """See `LearnedModel.checked`."""
        names = "percept", "control", "next_percept"
        p, u, q = (inputs.as_rows(row, name) for row, name in zip(rows, names, strict=True))
        if not len(p) == len(u) == len(q) or q.shape[1] != p.shape[1]:
            raise DataError(
                f"percept, control and next percept have {len(p)}, {len(u)} and {len(q)} rows of "
                f"{p.shape[1]}, {u.shape[1]} and {q.shape[1]}; pass equally many of D, U and D"
            )
        inputs.check_memory(len(p))
        return p, u, q

    def learnable(self, *rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """See `LearnedModel.learnable`."""
        return self.features(*rows[:2]), *self.targets(*rows)

    def loss(self, *rows: Tensor) -> Tensor:
        """See `LearnedModel.loss`."""
        return self.errors(self(*rows[:2]), rows[2])

    def widen(self, *rows: Tensor) -> None:
        """See `LearnedModel.widen`."""
        self.most = torch.maximum(self.most, self.extremes(*rows[:2]).amax(0))

    def measure_reach(self, features: Tensor) -> None:
        """Measure `reach`: 95 % of rows (n, F) have another centre within this squared distance."""
        some = features[:: max(1, len(features) // 1024)].double()
        distance = torch.cdist(some, self.machine.centres.double()).square()
        nearest = torch.where(distance < 1e-16, torch.inf, distance).amin(1)
        nearest = nearest[torch.isfinite(nearest)]
        if len(nearest) > 0:
            self.reach = nearest.quantile(0.95).clamp_min(1e-12)
        else:
            self.reach = torch.ones_like(self.machine.gamma_value)

    def with_fewer_centres(self, centres: int, percept: Tensor, control: Tensor) -> Self:
        """A model with fewer centres and nearly the same output (`cgtorch.svm.fit_reduced_set`)."""
        smaller, features = deepcopy(self), self.features(percept, control)
        smaller.machine = fit_reduced_set(self.machine, centres, features)
        smaller.measure_reach(features)  # few centres lie further apart
        return smaller


class KernelTransitionModel(TransitionModel):
    """Γ of any domain: it learns the change of each number of the percept.

    Angles enter as sine and cosine, and change by the shorter way. Discrete numbers are rounded,
    and all numbers stay within their bounds. Additional buffers are `shift` and `spread` (D,), the
    mean and the standard deviation of the changes, and `learnt` (D,), 0 for numbers whose change
    the machine could not predict in cross-validation; these change by the mean.
    """

    shift: Tensor
    spread: Tensor
    learnt: Tensor
    grid = Grid((1.0, 10.0, 100.0), (0.3, 1.0, 3.0), (0.02, 0.1), 600)

    def __init__(
        self, percept: Sequence[Field], control: Sequence[Field], further: Features | None = None
    ) -> None:
        """An unfitted Γ for percepts and controls, with additional features if given."""
        super().__init__()
        self.percept_fields, self.control_fields = tuple(percept), tuple(control)
        self.further = further
        for name in ("shift", "spread", "learnt"):
            self.register_buffer(name, torch.zeros(len(percept), dtype=torch.float64))
        self._angles = columns_of(percept, "angle")
        self._whole = columns_of(percept, "discrete")

    def fields(self, size: int) -> Sequence[Field]:
        """See `TransitionModel.fields`."""
        return self.percept_fields

    def standardise(
        self, percept: Tensor, control: Tensor, next_percept: Tensor, dtype: torch.dtype
    ) -> None:
        """See `TransitionModel.standardise`."""
        self.mean, self.scale = mean_and_spread(self.raw_features(percept, control))
        self.shift, self.spread = mean_and_spread(self.difference(percept, next_percept), percept)
        self.most = self.extremes(percept, control).amax(0).clamp_min(1e-3)

    def settle(self, rows: Sequence[Tensor], held: HeldOut) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.settle`."""
        self.learnt = held.learnt.to(self.spread)
        error, baseline = (held.value - held.target).abs().mean(0), held.target.abs().mean(0)
        return torch.where(held.learnt, error, baseline) * self.spread, baseline * self.spread

    def raw_features(self, percept: Tensor, control: Tensor) -> Tensor:
        """The features (..., F) before they are standardised."""
        sizes = len(self.percept_fields), len(self.control_fields)
        if (percept.shape[-1:], control.shape[-1:]) != ((sizes[0],), (sizes[1],)):
            raise DataError(
                f"percept and control have shapes {tuple(percept.shape)} and "
                f"{tuple(control.shape)}; pass (..., {sizes[0]}) and (..., {sizes[1]})"
            )
        control = within_bounds(control, self.control_fields)
        further = [] if self.further is None else [self.further(percept, control)]
        seen = as_features(percept, self.percept_fields), as_features(control, self.control_fields)
        return torch.cat([*seen, *further], -1)

    def features(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `TransitionModel.features`."""
        return self.standardised(self.raw_features(percept, control), "percept and control")

    def next_percept(self, percept: Tensor, control: Tensor, value: Tensor) -> Tensor:
        """See `TransitionModel.next_percept`."""
        learnt, shift, spread = (x.to(percept) for x in (self.learnt, self.shift, self.spread))
        after = percept + shift + spread * learnt * value
        after = within_bounds(after, self.percept_fields)
        if not self._whole:
            return after
        columns = list(after.unbind(-1))
        for i in self._whole:
            columns[i] = columns[i].round()
        return torch.stack(columns, -1)

    def difference(self, predicted: Tensor, seen: Tensor) -> Tensor:
        """See `TransitionModel.difference`; angles differ by the shorter way."""
        columns = list((seen - predicted).unbind(-1))
        for i in self._angles:
            columns[i] = wrapped(columns[i])
        return torch.stack(columns, -1)

    def errors(self, predicted: Tensor, seen: Tensor) -> Tensor:
        """See `TransitionModel.errors`: relative to the usual change of each number."""
        spread = self.spread.to(predicted)
        return (self.difference(predicted, seen) / spread).abs().mean(1)

    def extremes(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `TransitionModel.extremes`: the distance of each feature from its mean."""
        return self.features(percept, control).abs()

    def targets(
        self, percept: Tensor, control: Tensor, next_percept: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.targets`; every transition is informative."""
        change = self.difference(percept, next_percept)
        target = (change - self.shift.to(change)) / self.spread.to(change)
        return target, torch.ones(len(percept), dtype=torch.bool, device=percept.device)

    def shapes(self, features: int) -> dict[str, tuple[int, ...]]:
        """See `LearnedModel.shapes`."""
        own = dict.fromkeys(("shift", "spread", "learnt"), (len(self.percept_fields),))
        return {**super().shapes(features), "most": (features,), **own}
