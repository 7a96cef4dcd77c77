"""Input checks: training data as float64 tensors, and the memory that a fit needs."""

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cgtorch.ground.errors import DataError, SettingsError

MAX_MEMORY = 4 * 1024**3
"""The number of bytes that a fit may use for kernel matrices."""

FAR = 1e3
"""Median distances from the median, beyond which a target is an outlier."""


def as_tensor(values: Any, name: str) -> Tensor:
    """`values` (torch, numpy or nested lists) as a finite float64 tensor on its device."""
    try:
        tensor = values.detach() if isinstance(values, Tensor) else _from_array(values)
        if tensor.is_complex():
            raise TypeError(f"its type is {tensor.dtype}")
        tensor = tensor.to(torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        said = " ".join(str(error).split())[:200]
        raise DataError(f"{name} is not an array of numbers: {said}") from error
    if bad := int((~torch.isfinite(tensor)).sum()):
        raise DataError(f"{name} has {bad} NaN or infinite values; remove those rows first")
    return tensor


def _from_array(values: Any) -> Tensor:
    """A copy of an array-like, whatever its strides, byte order and number type."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"its type is {array.dtype}")
    return torch.from_numpy(np.array(array, dtype=np.float64, order="C"))


def as_rows(values: Any, name: str = "x") -> Tensor:
    """`values` as a finite float64 tensor (n, d) with n, d >= 1."""
    rows = as_tensor(values, name)
    if rows.ndim != 2 or 0 in rows.shape:
        raise DataError(f"{name} has shape {tuple(rows.shape)}; pass at least one row, (n, d)")
    return rows


def as_targets(values: Any, rows: int) -> Tensor:
    """`values` as float64 targets (n,) or (n, outputs) for `rows` rows."""
    targets = as_tensor(values, "y")
    if targets.ndim not in (1, 2) or len(targets) != rows or 0 in targets.shape:
        raise DataError(f"y has shape {tuple(targets.shape)}; pass one target per row, {rows} rows")
    return targets


def as_weights(values: Any, rows: int) -> Tensor:
    """`values` as float64 weights of rows (n,), at least 0 and not all 0; ones for None."""
    if values is None:
        return torch.ones(rows, dtype=torch.float64)
    weights = as_tensor(values, "sample_weight")
    if weights.shape != (rows,):
        raise DataError(
            f"sample_weight has shape {tuple(weights.shape)}; pass one weight per row, ({rows},)"
        )
    if bool((weights < 0).any()) or not bool(weights.any()):
        raise DataError(
            f"sample_weight reaches from {float(weights.min()):g} to {float(weights.max()):g}; "
            "no weight may be negative, and at least one must be positive"
        )
    return weights


def without_outliers(targets: Tensor) -> Tensor:
    """Targets (k, n), with the median of their output in place of those far from it.

    Far is `FAR` times the median distance of those that differ from it.
    """
    middle = targets.median(1, keepdim=True).values
    distance = (targets - middle).abs()
    typical = distance.masked_fill(distance == 0, torch.nan).nanmedian(1, keepdim=True).values
    return torch.where(distance > FAR * typical, middle, targets)


def as_binary(values: Any, rows: int) -> tuple[Tensor, Tensor]:
    """The two classes (2,), ascending, and the sign of each row (n,): -1 first class, 1 second."""
    labels = as_tensor(values, "y")
    if labels.shape != (rows,):
        raise DataError(f"y has shape {tuple(labels.shape)}; pass one label per row, ({rows},)")
    classes = labels.unique()
    if len(classes) != 2:
        shown = ", ".join(f"{value:g}" for value in classes[:5].tolist())
        raise DataError(f"y has {len(classes)} classes ({shown}); a classifier needs exactly two")
    return classes, torch.where(labels == classes[1], 1.0, -1.0).to(labels)


def as_given(result: Tensor, example: Any) -> Any:
    """`result` as numpy if `example` is not a tensor, else as it is."""
    return result if isinstance(example, Tensor) else result.detach().cpu().numpy()


def memory(rows: int) -> int:
    """The largest number of bytes that a fit to so many rows needs for kernel matrices.

    The solver keeps the kernel in float32 and float64 and, for the free rows, their rows, a block
    and its factor in float64: at most 36 bytes per pair.
    """
    return 36 * rows * rows


def check_memory(rows: int) -> None:
    """DataError if the kernel matrices of a fit would not fit in `MAX_MEMORY`."""
    if (needed := memory(rows)) > MAX_MEMORY:
        most = int((MAX_MEMORY / memory(1)) ** 0.5)
        raise DataError(
            f"{rows} rows would take {needed / 1e9:.1f} GB for kernel matrices and the limit is "
            f"{MAX_MEMORY / 1e9:.1f} GB; train on at most {most} rows"
        )


def training_rows(values: Any) -> Tensor:
    """`values` as rows (n, d) that a fit can have."""
    rows = as_rows(values)
    check_memory(len(rows))
    return rows


def as_number(value: Any) -> float:
    """`value` as a float, NaN if it is no number."""
    try:
        return float(value)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        return float("nan")


def positive(value: Any, name: str, or_zero: bool = False) -> float:
    """`value` as a finite float above 0, or 0 if that is allowed."""
    number = as_number(value)
    if not (0 < number < float("inf") or (or_zero and number == 0)):
        wanted = "0 or a positive number" if or_zero else "a positive number"
        raise SettingsError(f"{name} is {value!r:.80}; it must be {wanted}")
    return number


def per_output(value: Any, name: str, outputs: int, or_zero: bool = False) -> Tensor:
    """One positive float64 number per output (k,), or 0 if allowed, from a number or a sequence."""
    several = isinstance(value, Sequence | Tensor | np.ndarray) and not isinstance(value, str)
    given = list(value) if several else [value] * outputs
    if len(given) != outputs:
        raise SettingsError(f"{name} has {len(given)} values for {outputs} outputs")
    return torch.tensor([positive(one, name, or_zero) for one in given], dtype=torch.float64)


def generator_of(seed: int | torch.Generator) -> torch.Generator:
    """A generator on the CPU from a seed, or the given one."""
    if isinstance(seed, torch.Generator):
        return seed
    try:
        return torch.Generator().manual_seed(int(np.int64(operator.index(seed))))
    except (TypeError, ValueError, OverflowError) as error:
        raise SettingsError(
            f"seed is {seed!r:.80}; use a whole number of at most 63 bits, or a torch.Generator"
        ) from error
