"""Exact solutions from nearly exact ones, by full Newton steps on the active set.

This is a primal-dual active set method (Hintermueller, Ito & Kunisch 2003). Free coefficients solve
their equations with a small ridge h. Those that leave their boxes become bound, and bound ones on
the wrong side become free. The ridge rounds the corners of the loss over a width h C (Chapelle
2007), so that a residual r determines the coefficient soft(r, epsilon) / h, clipped to its box.
From a solution whose statuses are nearly right, it ends within a few steps, long before the values
of other methods are exact. It gives up if the number of changes grows.

The status of a coefficient is -2 or 2 on a bound, 0 at zero, and -1 or 1 if it is free below or
above zero.
"""

import torch
from torch import Tensor

from cgtorch.svm.problems import Problems, State, inside, violation

_STEPS = 12
_ROUNDING = 0.8  # of the tolerance, by which a ridge may move residuals
_SPARSE = 4  # where fewer than one coefficient in so many is not zero, the others are left out


def polish(kernel: Tensor, problem: Problems, start: State, tolerance: float) -> State | None:
    """The solution of a single problem, without the axis of problems, or None.

    The kernel matrix (n, n) must be positive semidefinite. The feasible coefficients of the start
    determine the first statuses. A solution violates no condition by more than the tolerance.
    """
    beta, bias, z = start.beta, start.bias, problem.z
    h = _ROUNDING * tolerance / torch.maximum(problem.upper, -problem.lower).max()
    residual = z - start.product - bias
    status = beta.sign() * (1 + ((beta >= problem.upper) | (beta <= problem.lower)).to(beta))
    before = len(z)
    for _ in range(_STEPS):
        status = _with_pivot(problem, h, residual, status)
        step = _step(kernel, problem, h, beta, residual, status)
        if step is None:
            return None
        d, shift, move = step
        beta, bias, residual = beta + d, bias + shift, residual - move - shift
        new = _changed(problem, h, beta, residual, status)
        flips = int((new != status).sum())
        fitting = inside(problem, beta)
        wrong = violation(problem, fitting, residual)
        if flips == 0 and bool(wrong <= tolerance):
            return State(fitting, z - residual - bias, bias, wrong)
        if flips > before:
            return None
        status, before = new, flips
    return None


def _asked(problem: Problems, h: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
    """The coefficients (n,) that residuals determine, and their statuses."""
    width = problem.epsilon
    value = (residual - torch.clamp(residual, -width, width)) / h
    clipped = inside(problem, value)
    return clipped, _statuses(value, clipped)


def _statuses(value: Tensor, clipped: Tensor) -> Tensor:
    """Statuses (n,) of coefficients before and after clipping them to their boxes."""
    return clipped.sign() * (2 - (value == clipped).to(value))


def _step(
    kernel: Tensor, problem: Problems, h: Tensor, beta: Tensor, residual: Tensor, status: Tensor
) -> tuple[Tensor, Tensor, Tensor] | None:
    """Newton step of the coefficients (n,) and the bias (), and its product with K (n,).

    Bound coefficients go to their bounds. The free ones solve (K_FF + h) d + shift = right with
    coefficients that sum to 0. None if K is not positive definite.
    """
    free = (status.abs() == 1).nonzero().flatten()
    bounds = (status == 2) * problem.upper + (status == -2) * problem.lower
    d = (bounds - beta).index_fill_(0, free, 0)
    outer = _product(kernel, d)
    right = (residual - h * beta - problem.epsilon * status.sign() - outer)[free]
    matrix = kernel.index_select(0, free).index_select(1, free)
    matrix.diagonal().add_(h)
    factor, info = torch.linalg.cholesky_ex(matrix)
    if int(info):
        return None
    columns = torch.stack([right, torch.ones_like(right)], 1)
    u, v = torch.cholesky_solve(columns, factor).unbind(1)
    shift = (u.sum() + (beta + d).sum()) / v.sum()
    inner = torch.zeros_like(d).index_copy_(0, free, u - shift * v)
    return d + inner, shift, outer + _product(kernel, inner)


def _product(kernel: Tensor, d: Tensor) -> Tensor:
    """K d (n,) for coefficients of which often few are not zero."""
    rows = d.nonzero().flatten()
    if _SPARSE * len(rows) > len(d):
        return kernel @ d
    return d[rows] @ kernel[rows]


def _with_pivot(problem: Problems, h: Tensor, residual: Tensor, status: Tensor) -> Tensor:
    """Statuses (n,) with one coefficient freed if none is free, as the bias needs an equation.

    The sum of the coefficients determines the direction of the bias. The first coefficient that
    leaves its bound in this direction becomes free.
    """
    if bool((status.abs() == 1).any()):
        return status
    r, width, upper, lower = residual, problem.epsilon, problem.upper, problem.lower
    if bool(_asked(problem, h, residual)[0].sum() > 0):
        distance = torch.where(status == 2, r - width - h * upper, torch.inf)
        distance = torch.where((status == 0) & (lower < 0), r + width, distance)
        side = -1.0
    else:
        distance = torch.where(status == -2, h * lower - width - r, torch.inf)
        distance = torch.where((status == 0) & (upper > 0), width - r, distance)
        side = 1.0
    pivot = int(distance.clamp_min(0).argmin())
    status = status.clone()
    status[pivot] = status[pivot].sign() if bool(status[pivot]) else side
    return status


def _changed(
    problem: Problems, h: Tensor, beta: Tensor, residual: Tensor, status: Tensor
) -> Tensor:
    """Statuses (n,) after a step.

    Free coefficients out of their box become bound. Bound ones on the wrong side become free. For
    free coefficients, residuals are not tested, as they are only rounding errors.
    """
    bound = _statuses(beta, inside(problem, beta))
    bound = bound * (status * bound >= 0)  # from one side to the other only by way of zero
    asked = _asked(problem, h, residual)[1]
    freed = torch.where(status == 0, asked, status).sign()
    return torch.where(status.abs() == 1, bound, torch.where(asked == status, status, freed))
