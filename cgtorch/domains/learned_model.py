"""What Γ and C share: a support vector machine on standardised features, which learns on.

When more data come, hyper-parameters, standardisation and C's probability curve stay; the solver
starts from the old coefficients, so the answer is the exact solution on all rows, old and new, and
only the way there is shorter.
"""

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.svm import SVC, SVR
from cgtorch.svm.coreset import shrink_to_coreset
from cgtorch.svm.machine import FittedModule


class LearnedModel(FittedModule, ABC):
    """A `machine` on standardised features, whose `mean` and `scale` (F,) are buffers.

    What it learns from are n rows of several tensors: percepts, controls and next percepts of Γ,
    percepts and labels of C.
    """

    mean: Tensor
    scale: Tensor
    machine: SVC | SVR

    def __init__(self, machine: SVC | SVR) -> None:
        super().__init__()
        for name in ("mean", "scale"):
            self.register_buffer(name, torch.zeros(0, dtype=torch.float64))
        self.machine = machine

    @abstractmethod
    def checked(self, *rows: Any) -> tuple[Tensor, ...]:
        """Rows to learn from in float64; DataError where nothing can be learnt from them."""

    @abstractmethod
    def learnable(self, *rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features (n, F), what the machine is to say, and (n,) bool which of the rows tell it."""

    @abstractmethod
    def loss(self, *rows: Tensor) -> Tensor:
        """How wrong the model is on each of the rows (n,), by which models are compared."""

    def widen(self, *rows: Tensor) -> None:
        """Let what is known of the range of the data cover more rows, in place."""

    def measure_reach(self, features: Tensor) -> None:
        """Find out how far from a centre is still known, by features (n, F), in place."""

    def standardised(self, raw: Tensor, made_of: str) -> Tensor:
        """Features (..., F) less their mean, in units of their scale; DataError of another F."""
        raw = raw.to(self.mean)
        if raw.shape[-1] != len(self.mean):
            raise DataError(
                f"{made_of} make {raw.shape[-1]} features; the model was fitted on {len(self.mean)}"
            )
        return (raw - self.mean) / self.scale

    def shapes(self, features: int) -> dict[str, tuple[int, ...]]:
        """The shapes of the buffers, but for the machine's, given F; files are checked by them."""
        return dict.fromkeys(("mean", "scale"), (features,))

    def updated(self, *rows: Any) -> Self:
        """A new model fitted on all rows, those of the last fit first and in the same order.

        This one, which must not be compact, stays as it is. DataError for wrong shapes, NaN, one
        class only, or fewer rows than before, and ModelError if it is not fitted.
        """
        exact = self.checked(*rows)
        fresh = deepcopy(self).double().to(exact[0].device)
        fresh.machine._check_fitted()
        fresh.widen(*exact)
        if bool(fresh.machine.cost.any()):  # else it says nothing, since nothing could be learnt
            features, target, tells = fresh.learnable(*exact)
            fresh.machine.learn_on(features[tells], target[tells])
            fresh.measure_reach(features[tells])
        return fresh.to(self.mean.dtype)

    def coreset(self, *rows: Tensor, limit: int) -> tuple[Tensor, Self]:
        """At most `limit` of the rows that it was fitted on, and a model to go on from there.

        These are the indices (m,) that stay, ascending, and the start of an update, which predicts
        as before only if no support vector had to go. Rows that tell the machine nothing go first.
        """
        if len(rows[0]) <= limit:
            return torch.arange(len(rows[0]), device=rows[0].device), self
        *_, tells = deepcopy(self).double().learnable(*(x.double() for x in rows))
        features, telling = self.learnable(*rows)[0], tells.nonzero().flatten()
        smaller = deepcopy(self)
        return telling[shrink_to_coreset(smaller.machine, features[telling], limit)], smaller


def mean_and_spread(values: Tensor) -> tuple[Tensor, Tensor]:
    """Means and standard deviations (k,) of values (n, k), 1 where they do not differ."""
    spread = values.std(0, correction=0)
    differ = spread > 1e-9 * (1 + values.abs().amax(0))
    return values.mean(0), torch.where(differ, spread, 1.0)
