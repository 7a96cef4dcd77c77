"""Folds, scores, and learning curves: scores by the number of training rows.

Every size, fold and output of a learning curve is a dual problem of one batch, with the same kernel
matrix. Rows that it must not learn from have the box [0, 0].
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.svm import inputs
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.problems import Targets
from cgtorch.svm.rbf import Gram
from cgtorch.svm.solver import solve


def fold_numbers(folds: Any, targets: Targets, generator: Generator) -> Tensor:
    """Fold numbers (n,): random for a number of folds, stratified for classes, or as given.

    SettingsError for fewer than two folds, DataError for too few rows or impossible given folds.
    """
    rows = targets.y.shape[1]
    if isinstance(folds, int):
        if targets.classes is not None:
            return stratified_folds(targets.y[0], folds, generator)
        return plain_folds(rows, folds, generator)
    numbers = inputs.as_tensor(folds, "folds").cpu()
    whole = numbers.shape == (rows,) and torch.equal(numbers, numbers.floor())
    if not whole or bool((numbers < 0).any()) or len(numbers.unique()) < 2:
        raise DataError(f"the given folds do not place each of {rows} rows in one of 2 or more")
    return numbers.unique(return_inverse=True)[1]


def plain_folds(rows: int, count: int, generator: Generator) -> Tensor:
    """Random fold numbers (n,); the sizes of folds differ by at most one."""
    if count < 2:
        raise SettingsError(f"folds is {count}; cross-validation needs at least 2")
    if rows < count:
        raise DataError(f"{rows} rows cannot make {count} folds; use fewer folds or more rows")
    return torch.randperm(rows, generator=generator) % count


def stratified_folds(signs: Tensor, count: int, generator: Generator) -> Tensor:
    """Random fold numbers (n,) with each class of `signs` (n,) spread evenly."""
    folds = torch.zeros(len(signs), dtype=torch.long)
    for value in signs.unique():
        rows = (signs == value).nonzero().flatten().cpu()
        if len(rows) < count:
            raise DataError(
                f"one class has {len(rows)} rows, fewer than the {count} folds; use fewer folds"
            )
        folds[rows] = plain_folds(len(rows), count, generator)
    return folds


def training_masks(folds: Tensor) -> Tensor:
    """Masks (F, n) of the rows on which each of the F folds trains."""
    return folds[None] != torch.arange(int(folds.max()) + 1)[:, None]


Score: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps values and truth (..., n) to scores (...); more is better."""


def accuracy(value: Tensor, truth: Tensor) -> Tensor:
    """Share of rows (..., n) whose decision value has the sign of the truth."""
    return ((value > 0) == (truth > 0)).double().mean(-1)


def balanced_accuracy(value: Tensor, truth: Tensor) -> Tensor:
    """Mean over the two classes of the share of their rows (..., n) that are right."""
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


SCORES: dict[str, Score] = {
    score.__name__: score for score in (accuracy, balanced_accuracy, r2, neg_mean_absolute_error)
}


def score_of(name: str) -> Score:
    """The score with a name in `SCORES`; SettingsError if there is none."""
    if name not in SCORES:
        raise SettingsError(f"scoring is {name!r}; choose one of {sorted(SCORES)}")
    return SCORES[name]


@dataclass(frozen=True)
class LearningCurve:
    """Scores by the number of training rows; more is better.

    Attributes:
        sizes: Numbers of training rows (S,).
        train_scores: Score on these rows, by size and fold (S, F).
        test_scores: Score on the rows that the fold holds out, by size and fold (S, F).
    """

    sizes: tuple[int, ...]
    train_scores: tuple[tuple[float, ...], ...]
    test_scores: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class LearningValues:
    """Values on all rows of every model of a learning curve.

    Attributes:
        sizes: Numbers of training rows (S,).
        values: Decision values or predictions, by size, fold and output (S, F, k, n).
        targets: Signs or targets (k, n).
        used: Whether a row was trained on, by size and fold (S, F, n).
        folds: Fold number of each row (n,).
    """

    sizes: tuple[int, ...]
    values: Tensor
    targets: Tensor
    used: Tensor
    folds: Tensor

    @property
    def held_out(self) -> Tensor:
        """Value of each row from the largest model whose fold held it out (k, n)."""
        index = torch.arange(len(self.folds), device=self.folds.device)
        return self.values[-1, self.folds, :, index].T

    def scored(self, scoring: str) -> LearningCurve:
        """Scores by a name in `SCORES`, averaged over outputs; SettingsError for another name."""
        score = score_of(scoring)

        def mean(value: Tensor, rows: Tensor) -> float:
            return float(score(value[:, rows], self.targets[:, rows]).mean())

        train, test = [], []
        for value, used in zip(self.values, self.used, strict=True):
            folds = range(len(value))
            train.append(tuple(mean(value[f], used[f]) for f in folds))
            test.append(tuple(mean(value[f], self.folds == f) for f in folds))
        return LearningCurve(self.sizes, tuple(train), tuple(test))


def doubling_sizes(rows: int, folds: int = 5, count: int = 5) -> tuple[int, ...]:
    """Up to `count` sizes, each twice the one before, that plain or stratified `folds` allow.

    The largest is what any fold of `rows` leaves, less at most two. There is no size below 16.
    """
    most = rows - rows // folds - 2  # each of two classes may leave one row over in the same fold
    return tuple(size for k in reversed(range(count)) if (size := most >> k) >= 16) or (most,)


def learning_values(
    model: KernelMachine,
    x: Any,
    y: Any,
    *,
    sizes: Sequence[int],
    folds: Any = 5,
    seed: int | Generator = 0,
) -> LearningValues:
    """Values on all rows of models trained on the first rows of each training fold.

    As in scikit-learn's `learning_curve`, rows are used in the given order, so shuffle those whose
    order has a meaning. For arguments and errors see `grid_search`; a gamma of "scale" is that of
    all rows. SettingsError if there are no `sizes` (S,), or if one is below 1 or larger than the
    smallest training fold.
    """
    rows = inputs.training_rows(x)
    targets = model.targets(y, rows)
    numbers = fold_numbers(folds, targets, inputs.generator_of(seed))
    used = _first_rows(training_masks(numbers), sizes).to(rows.device)
    problems = model.problems(targets, used.flatten(0, 1))
    by_mask = torch.arange(len(problems.z), device=rows.device).unflatten(0, (len(targets.y), -1))
    found = solve(Gram(rows, model.gamma), problems.take(by_mask.T.flatten()))
    values = (found.product + found.bias[:, None]).reshape(*used.shape[:2], *targets.y.shape)
    restored, folds = targets.restored(values), numbers.to(rows.device)
    return LearningValues(tuple(sizes), restored, targets.y, used, folds)


def _first_rows(masks: Tensor, sizes: Sequence[int]) -> Tensor:
    """Masks (S, F, n) of the first rows of each training fold, whose masks are (F, n)."""
    most = int(masks.sum(1).min())
    if not sizes or not all(isinstance(s, int) and 1 <= s <= most for s in sizes):
        raise SettingsError(f"sizes are {tuple(sizes)}; give numbers of rows from 1 to {most}")
    return masks & (masks.cumsum(1) <= torch.tensor(sizes)[:, None, None])
