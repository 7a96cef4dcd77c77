"""Pivoted Cholesky: the factor of low rank that a positive semidefinite matrix nearly is.

Each step takes the row with the largest rest on the diagonal (Fine & Scheinberg 2001).
"""

from collections.abc import Callable

import torch
from torch import Tensor

_FLOOR = 1e-12  # of the largest diagonal element, below which the rest is rounding


def pivoted_cholesky(
    diagonal: Tensor, column: Callable[[int], Tensor], most: int, trace: float = 0.0
) -> tuple[Tensor, list[int], float]:
    """Factor a matrix until the trace of what is missing is small.

    Args:
        diagonal: Diagonal of the matrix (n,).
        column: Gives one of its columns (n,).
        most: Largest rank.
        trace: Trace of the rest at which to stop.

    Returns:
        The factor (rank, n), whose transpose times itself is nearly the matrix, the rows taken in
        their order, and the trace of the rest.
    """
    rest = diagonal.clone()
    factor = diagonal.new_zeros(min(most, len(diagonal)), len(diagonal))
    chosen: list[int] = []
    floor = _FLOOR * float(rest.max())
    for step in range(len(factor)):
        pivot = int(rest.argmax())
        largest = float(rest[pivot])
        if largest <= floor or float(rest.sum()) <= trace:
            break
        torch.addmv(column(pivot), factor[:step].T, factor[:step, pivot], alpha=-1, out=factor[step])
        factor[step] /= largest**0.5
        rest = (rest - factor[step] ** 2).clamp_min_(0)
        rest[pivot] = 0
        chosen.append(pivot)
    return factor[: len(chosen)], chosen, float(rest.sum())
