"""Exact solutions from nearly right ones: full Newton steps on statuses.

A primal-dual active set (Hintermueller, Ito & Kunisch 2003) without line search or ladder: free
coefficients solve their equations with a ridge that leaves less violation than is asked for, those
that leave their boxes are bound, and bound ones on the wrong side are freed. From a solution whose
statuses are nearly right it ends within a few steps; where the number of changes grows it is given
up at once.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.svm.gram import Gram
from cgtorch.svm.newton import direction, with_pivot
from cgtorch.svm.problems import Problems, inside, violation
from cgtorch.svm.smoothed_loss import classify, slope, statuses

_STEPS = 12
_ROUNDING = 0.9  # of the tolerance, by which a ridge may move residuals
_OUTSIDE = 1e-6  # of the box: how far inexact equations may push a coefficient out of it


@dataclass(frozen=True)
class Polished:
    """Exact solutions of those of P problems that are `solved` (P,): beta (P, n), bias (P,)."""

    beta: Tensor
    bias: Tensor
    solved: Tensor


def polish(
    gram: Gram, problems: Problems, beta: Tensor, bias: Tensor, tolerance: float
) -> Polished:
    """Try to solve P problems from coefficients (P, n) in their boxes and biases (P,).

    Args:
        gram: Kernel values among n rows, positive semidefinite.
        problems: P problems over the rows.
        beta: Coefficients, which say who is free and who is bound.
        bias: Biases.
        tolerance: Largest violation of the optimality conditions of a solution.
    """
    found = Polished(beta.clone(), bias.clone(), torch.zeros_like(bias, dtype=torch.bool))
    live = torch.arange(len(bias), device=bias.device)
    box = torch.maximum(problems.upper, -problems.lower).amax(1)
    h = _ROUNDING * tolerance / box
    status = classify(beta, problems.lower, problems.upper)
    residual = problems.z - gram.times(beta) - bias[:, None]
    before, precise = torch.full_like(live, len(gram)), [False] * len(live)
    for _ in range(_STEPS):
        status = with_pivot(problems, h, residual, slope(problems, h, residual)[1], status)
        free = status.abs() == 1
        d, shift, move = direction(gram, problems, h, beta, residual, status, free, precise)
        beta, bias, residual = beta + d, bias + shift, residual - move - shift[:, None]
        new = _changed(problems, h, beta, residual, status, free)
        flips = (new != status).sum(1)
        fitting = inside(problems, beta)
        right = (flips == 0) & (violation(problems, fitting, residual) <= tolerance)
        right &= (beta - fitting).abs().amax(1) <= _OUTSIDE * box
        at = live[right]
        found.beta[at], found.bias[at], found.solved[at] = fitting[right], bias[right], True
        rest = (~right & (flips <= before)).nonzero().flatten()
        if len(rest) == 0:
            break
        precise = [precise[row] for row in rest.tolist()]
        live, problems, h, box = live[rest], problems.take(rest), h[rest], box[rest]
        beta, bias, residual = beta[rest], bias[rest], residual[rest]
        status, before = new[rest], flips[rest]
    return found


def _changed(
    problems: Problems, h: Tensor, beta: Tensor, residual: Tensor, status: Tensor, free: Tensor
) -> Tensor:
    """Statuses (P, n) after a step: out of the box is bound, on the wrong side of a bound free.

    Free coefficients speak for themselves, as their residuals are the rounding of their factor.
    """
    bound = statuses(beta, inside(problems, beta))
    bound = bound * (status * bound >= 0)  # from one side to the other only by way of zero
    asked = statuses(*slope(problems, h, residual))
    freed = torch.where(status == 0, asked, status).sign()
    return torch.where(free, bound, torch.where(asked == status, status, freed))
