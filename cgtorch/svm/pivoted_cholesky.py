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
        trace: Trace of the rest at which to stop; it also stops when that is not to be expected.

    Returns:
        The factor (rank, n), whose transpose times itself is nearly the matrix, the rows taken in
        their order, and the trace of the rest.
    """
    rest = diagonal.clone()
    factor = diagonal.new_zeros(min(most, len(diagonal)), len(diagonal))
    chosen: list[int] = []
    floor = _FLOOR * float(rest.max())
    # Traces fall geometrically at best, so what is not half way by a quarter will not arrive.
    quarter, hopeful = len(factor) // 4, (trace * float(rest.sum())) ** 0.5 if trace else torch.inf
    for step in range(len(factor)):
        pivot = int(rest.argmax())
        largest = float(rest[pivot])
        left = float(rest.sum())
        if largest <= floor or left <= trace or (step == quarter and left > hopeful):
            break
        row = torch.addmv(column(pivot), factor[:step].T, factor[:step, pivot], alpha=-1)
        factor[step] = row / largest**0.5
        rest = (rest - factor[step] ** 2).clamp_min_(0)
        rest[pivot] = 0
        chosen.append(pivot)
    return factor[: len(chosen)], chosen, float(rest.sum())
