"""Folds for cross-validation: a fold number for each row."""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

from cgtorch.errors import DataError, SettingsError


def plain_folds(rows: int, count: int, generator: torch.Generator) -> Tensor:
    """Random fold numbers (n,), the folds' sizes differing by at most one.

    Raises:
        SettingsError: Fewer than two folds.
        DataError: Fewer rows than folds.
    """
    if count < 2:
        raise SettingsError(f"folds is {count}; cross-validation needs at least 2")
    if rows < count:
        raise DataError(f"{rows} rows cannot make {count} folds; use fewer folds or more rows")
    return torch.randperm(rows, generator=generator) % count


def stratified_folds(signs: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Random fold numbers (n,) with each class of `signs` (n,) spread evenly.

    Raises:
        SettingsError: Fewer than two folds.
        DataError: A class has fewer rows than there are folds.
    """
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
    """Fold numbers (n,) from fold numbers, or from (train, test) index pairs that cover all rows.

    Raises:
        DataError: They do not give each of the rows exactly one fold.
    """
    if isinstance(folds, Iterable) and not hasattr(folds, "shape"):
        numbers = torch.full((rows,), -1, dtype=torch.long)
        times = 0
        for number, (_, test) in enumerate(folds):
            index = torch.as_tensor(test)
            numbers[index] = number
            times += len(index)
        if times != rows:
            numbers[0] = -1
    else:
        numbers = torch.as_tensor(folds).long().cpu()
    if numbers.shape != (rows,) or bool((numbers < 0).any()) or len(numbers.unique()) < 2:
        raise DataError(f"the given folds do not place each of {rows} rows in one of 2 or more")
    return numbers.unique(return_inverse=True)[1]


def training_masks(folds: Tensor) -> Tensor:
    """Masks (F, n) of the rows that each of the F folds trains on."""
    return folds[None] != torch.arange(int(folds.max()) + 1)[:, None]
