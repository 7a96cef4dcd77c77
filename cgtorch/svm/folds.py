"""Folds for cross-validation: a fold number for each row."""

from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.svm import inputs
from cgtorch.svm.problems import Targets


def fold_numbers(folds: Any, targets: Targets, generator: torch.Generator) -> Tensor:
    """Fold numbers (n,): random for a number of folds, stratified for classes, or as given.

    SettingsError for fewer than two folds, DataError for too few rows or impossible given folds.
    """
    rows = targets.y.shape[1]
    if not isinstance(folds, int):
        return given_folds(folds, rows)
    if targets.classes is not None:
        return stratified_folds(targets.y[0], folds, generator)
    return plain_folds(rows, folds, generator)


def plain_folds(rows: int, count: int, generator: torch.Generator) -> Tensor:
    """Random fold numbers (n,); the sizes of folds differ by at most one."""
    if count < 2:
        raise SettingsError(f"folds is {count}; cross-validation needs at least 2")
    if rows < count:
        raise DataError(f"{rows} rows cannot make {count} folds; use fewer folds or more rows")
    return torch.randperm(rows, generator=generator) % count


def stratified_folds(signs: Tensor, count: int, generator: torch.Generator) -> Tensor:
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


def given_folds(folds: Any, rows: int) -> Tensor:
    """Fold numbers (n,) from 0 on, from any integers."""
    numbers = inputs.as_tensor(folds, "folds").cpu()
    whole = numbers.shape == (rows,) and torch.equal(numbers, numbers.floor())
    if not whole or bool((numbers < 0).any()) or len(numbers.unique()) < 2:
        raise DataError(f"the given folds do not place each of {rows} rows in one of 2 or more")
    return numbers.unique(return_inverse=True)[1]


def training_masks(folds: Tensor) -> Tensor:
    """Masks (F, n) of the rows on which each of the F folds trains."""
    return folds[None] != torch.arange(int(folds.max()) + 1)[:, None]
