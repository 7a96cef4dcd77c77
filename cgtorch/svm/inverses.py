"""(K + rho)^-1 for a kernel matrix, whole or by way of a factor of low rank."""

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.svm.pivoted_cholesky import pivoted_cholesky

_SMALL = 0.25  # rank, as a share of the rows, up to which a factor is faster than the whole
_REST = 5e-3  # trace of what the factor lacks, in mean diagonal elements


@dataclass(frozen=True)
class Whole:
    """(K + rho)^-1 as a matrix.

    Attributes:
        rho: What is added to the diagonal.
        projected: The inverse times rho, projected on sums of 0 (n, n), float32.
        rows: Row sums of the inverse (n,).
        total: The sum of these ().
    """

    rho: float
    projected: Tensor
    rows: Tensor
    total: Tensor

    def add(self, x: Tensor, v: Tensor) -> Tensor:
        """Rho v (K + rho)^-1 (P, n), projected on sums of 0, added to x."""
        return torch.addmm(x, v, self.projected)


@dataclass(frozen=True)
class Factored:
    """(K + rho)^-1 as (1 - left @ right) / rho.

    Attributes:
        rho: What is added to the diagonal.
        left: First factor (n, r + 1), float32, which also holds the projection on sums of 0.
        right: Second factor (r + 1, n), float32.
        rows: Row sums of the inverse (n,).
        total: The sum of these ().
    """

    rho: float
    left: Tensor
    right: Tensor
    rows: Tensor
    total: Tensor

    def add(self, x: Tensor, v: Tensor) -> Tensor:
        """Rho v (K + rho)^-1 (P, n), projected on sums of 0, added to x."""
        return torch.addmm(x + v, v @ self.left, self.right, alpha=-1)


Inverse: TypeAlias = Whole | Factored


def low_rank(matrix: Tensor) -> Tensor | None:
    """A factor (r, n) whose transpose times itself is nearly `matrix`, None if r would be large."""
    diagonal = matrix.diagonal()
    most, trace = int(_SMALL * len(matrix)), _REST * float(diagonal.mean())
    factor, _, rest = pivoted_cholesky(diagonal, matrix.__getitem__, most, trace)
    return factor if rest <= trace else None


def inverse(matrix: Tensor, factor: Tensor | None, rho: float) -> Inverse:
    """The inverse of a kernel matrix (n, n) + rho, from its factor (r, n) if it has one."""
    if factor is None:
        return _whole(matrix, rho)
    small = factor @ factor.T
    small.diagonal().add_(rho)
    right = torch.cholesky_solve(factor, torch.linalg.cholesky(small))
    rows = (1 - factor.T @ right.sum(1)) / rho
    total = rows.sum()
    left = torch.cat([factor.T, rows[:, None] * (rho / total)], 1)
    right = torch.cat([right, rows[None]])
    return Factored(rho, left.float(), right.float(), rows, total)


def _whole(matrix: Tensor, rho: float) -> Whole:
    """By a factor in float32 if that can be."""
    for kind in (torch.float32, torch.float64):
        shifted = matrix.to(kind, copy=True)
        shifted.diagonal().add_(rho)
        factor, info = torch.linalg.cholesky_ex(shifted)
        if int(info) == 0:
            break
    found = torch.cholesky_inverse(factor).float()
    rows = found.sum(1)
    total = rows.sum()
    projected = found.addr_(rows, rows / -total).mul_(rho)
    return Whole(rho, projected, rows.double(), total.double())
