"""The common base of Γ and C: a support vector machine on standardised features.

It can learn from more data. Hyper-parameters, standardisation and C's probability curve then stay
as they are. The solver starts from the old coefficients, so the result is the exact solution on all
rows, old and new, and takes less time.
"""

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.svm import SVC, SVR
from cgtorch.svm.machine import FittedModule
from cgtorch.svm.reduced_set import shrink_to_coreset

EVEN = 1e-9  # the largest spread of numbers that do not vary, as a share of the largest
ROUNDING = 1e-15  # of numbers near 1, from which features are made, and of larger ones as a share


class LearnedModel(FittedModule, ABC):
    """A `machine` on standardised features, whose `mean` and `scale` (F,) are buffers.

    It learns from n rows of several tensors: percepts, controls and next percepts for Γ, percepts
    and labels for C.
    """

    mean: Tensor
    scale: Tensor
    machine: SVC | SVR

    def __init__(self, machine: SVC | SVR) -> None:
        super().__init__()
        for name in ("mean", "scale"):
            self.register_buffer(name, torch.empty(0, dtype=torch.float64))
        self.machine = machine

    @abstractmethod
    def checked(self, *rows: Any) -> tuple[Tensor, ...]:
        """Rows to learn from, in float64; DataError if they are not valid."""

    @abstractmethod
    def learnable(self, *rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features (n, F), targets of the machine, and (n,) bool, which rows are informative."""

    @abstractmethod
    def loss(self, *rows: Tensor) -> Tensor:
        """The error of the model on each of the rows (n,), by which models are compared."""

    def widen(self, *rows: Tensor) -> None:
        """Extend the known range of the data to more rows, in place."""

    def measure_reach(self, features: Tensor) -> None:
        """Measure by features (n, F) how far from a centre data are still familiar, in place."""

    def standardised(self, raw: Tensor, made_of: str) -> Tensor:
        """Standardised features (..., F); DataError for another F."""
        raw = raw.to(self.mean)
        if raw.shape[-1] != len(self.mean):
            raise DataError(
                f"{made_of} make {raw.shape[-1]} features; the model was fitted on {len(self.mean)}"
            )
        return (raw - self.mean) / self.scale

    def shapes(self, features: int) -> dict[str, tuple[int, ...]]:
        """The shapes of the buffers, except the machine's, given F; they serve to check files."""
        return dict.fromkeys(("mean", "scale"), (features,))

    def updated(self, *rows: Any) -> Self:
        """A new model fitted to all rows: those of the last fit first, in the same order.

        This model stays as it is, and must not have a reduced set. DataError for wrong shapes, NaN,
        one class only, or fewer rows than before; ModelError if it is not fitted.
        """
        exact = self.checked(*rows)
        fresh = deepcopy(self).double().to(exact[0].device)
        fresh.machine.check_fitted()
        fresh.widen(*exact)
        if bool(fresh.machine.cost.any()):  # else it is None, since nothing could be learnt
            features, target, tells = fresh.learnable(*exact)
            fresh.machine.learn_on(features[tells], target[tells])
            fresh.measure_reach(features[tells])
        return fresh.to(self.mean.dtype)

    def coreset(self, *rows: Tensor, limit: int) -> tuple[Tensor, Self]:
        """Indices (m,) of at most `limit` of the fitted rows, ascending, and a model to update.

        The model's predictions are unchanged unless support vectors had to be removed. Rows without
        information are removed first.
        """
        if len(rows[0]) <= limit:
            return torch.arange(len(rows[0]), device=rows[0].device), self
        *_, tells = deepcopy(self).double().learnable(*(x.double() for x in rows))
        features, telling = self.learnable(*rows)[0], tells.nonzero().flatten()
        smaller = deepcopy(self)
        return telling[shrink_to_coreset(smaller.machine, features[telling], limit)], smaller


def mean_and_spread(values: Tensor, of: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Means and standard deviations (k,) of values (n, k); 1 in place of one that is rounding.

    Values may be differences `of` numbers (n, k), whose rounding errors they have.
    """
    spread, largest = values.std(0, correction=0), values.abs().amax(0)
    numbers = largest if of is None else of.abs().amax(0)
    differ = spread > EVEN * largest + ROUNDING * (1 + numbers)
    return values.mean(0), torch.where(differ, spread, 1.0)
