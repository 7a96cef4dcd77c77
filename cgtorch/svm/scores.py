"""Scores of values against the truth, for grid searches and learning curves."""

from collections.abc import Callable
from typing import TypeAlias

from torch import Tensor

from cgtorch.ground.errors import SettingsError


def accuracy(value: Tensor, truth: Tensor) -> Tensor:
    """Share of rows (..., n) whose decision value has the sign of the truth."""
    return ((value > 0) == (truth > 0)).double().mean(-1)


def balanced_accuracy(value: Tensor, truth: Tensor) -> Tensor:
    """Mean over the two classes of the share of their rows that are right."""
    right, positive = (value > 0) == (truth > 0), (truth > 0).expand_as(value)
    first = (right & positive).sum(-1) / positive.sum(-1).clamp_min(1)
    second = (right & ~positive).sum(-1) / (~positive).sum(-1).clamp_min(1)
    return (first.double() + second.double()) / 2


def r2(value: Tensor, truth: Tensor) -> Tensor:
    """Share of the variance of the truth (..., n) that is explained."""
    spread = (truth - truth.mean(-1, keepdim=True)).square().sum(-1)
    return 1 - (value - truth).square().sum(-1) / spread.clamp_min(1e-300)


def neg_mean_absolute_error(value: Tensor, truth: Tensor) -> Tensor:
    """Minus the mean absolute error over rows (..., n)."""
    return -(value - truth).abs().mean(-1)


Score: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps values and truth (..., n) to scores (...); more is better."""

SCORES: dict[str, Score] = {
    score.__name__: score for score in (accuracy, balanced_accuracy, r2, neg_mean_absolute_error)
}


def score_of(name: str) -> Score:
    """The score with a name in `SCORES`; SettingsError if there is none."""
    if name not in SCORES:
        raise SettingsError(f"scoring is {name!r}; choose one of {sorted(SCORES)}")
    return SCORES[name]
