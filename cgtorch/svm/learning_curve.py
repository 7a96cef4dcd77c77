"""Learning curves: scores by the number of training rows, from one batched exact solve.

Every size, fold and output is a dual problem with the same kernel matrix. Rows that it must not
learn from have the box [0, 0]. The values on all rows, used or not, come at no extra cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.svm import inputs
from cgtorch.svm.folds import fold_numbers, training_masks
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.scores import score_of
from cgtorch.svm.solver import solve


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

    The largest is what any fold of `rows` leaves, less at most two rows. Sizes below 16 rows are
    left out, as almost nothing can be learned from them.
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

    The definition is that of scikit-learn's `learning_curve`: for every fold and size, train on the
    first rows outside the fold, in the given order. Shuffle rows whose order has a meaning.

    For arguments and errors see `grid_search`. A gamma of "scale" is that of all rows. The `sizes`
    are numbers of training rows (S,). SettingsError if there are none, or if one is below 1 or
    larger than the smallest training fold.
    """
    rows = model.training_rows(x)
    targets = model.targets(y, rows)
    numbers = fold_numbers(folds, targets, inputs.generator_of(seed))
    used = _first_rows(training_masks(numbers), sizes).to(rows.device)
    problems = model.problems(targets, used.flatten(0, 1))
    by_mask = torch.arange(len(problems.z), device=rows.device).unflatten(0, (len(targets.y), -1))
    found = solve(model.gram(rows), problems.take(by_mask.T.flatten()))
    values = (found.product + found.bias[:, None]).reshape(*used.shape[:2], *targets.y.shape)
    restored, folds = targets.restored(values), numbers.to(rows.device)
    return LearningValues(tuple(sizes), restored, targets.y, used, folds)


def _first_rows(masks: Tensor, sizes: Sequence[int]) -> Tensor:
    """Masks (S, F, n) of the first rows of each training fold, whose masks are (F, n)."""
    most = int(masks.sum(1).min())
    if not sizes or not all(isinstance(s, int) and 1 <= s <= most for s in sizes):
        raise SettingsError(f"sizes are {tuple(sizes)}; give numbers of rows from 1 to {most}")
    place = masks.cumsum(1)
    return masks & (place <= torch.tensor(sizes)[:, None, None])
