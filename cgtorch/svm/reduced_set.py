"""Fewer centres: a machine of a given size that answers nearly like the exact one.

The centres are picked by pivoted Cholesky (Fine & Scheinberg 2001), the greedy choice of those
that the others explain least, and their weights fitted by QR to the exact model's answers.
"""

from copy import deepcopy
from typing import TypeVar

import torch
from torch import Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.svm.gram import rbf
from cgtorch.svm.inputs import as_rows
from cgtorch.svm.machine import KernelMachine

Machine = TypeVar("Machine", bound=KernelMachine)

_FLOOR = 1e-12  # below which the rest is rounding
_RIDGES = tuple(10.0**-power for power in range(1, 11))


def pivots(x: Tensor, gamma: float, count: int) -> Tensor:
    """Indices (<= count,) of the rows x (n, d) that pivoted Cholesky picks, largest rest first."""
    rest = x.new_ones(len(x))
    factor, chosen = rest.new_zeros(count, len(x)), []
    for step in range(min(count, len(x))):
        pivot = int(rest.argmax())
        largest = float(rest[pivot])
        if largest <= _FLOOR:
            break
        column = rbf(x[pivot : pivot + 1], x, gamma)[0]
        row = torch.addmv(column, factor[:step].T, factor[:step, pivot], alpha=-1)
        factor[step] = row / largest**0.5
        rest = (rest - factor[step] ** 2).clamp_min_(0)
        rest[pivot] = 0
        chosen.append(pivot)
    return torch.tensor(chosen, dtype=torch.long, device=x.device)


def fit_reduced_set(machine: Machine, centres: int, x: Tensor) -> Machine:
    """A machine with at most `centres` centres fitted to the values of a fitted one on rows (n, d).

    These are at least 8 rows of the region where it will be asked. Three of four fit the weights,
    the fourth chooses the ridge, by answers in the type that the machine computes in, so that
    weights too large for it are not chosen. The probabilities of an `SVC` keep its Platt
    parameters. ModelError if the machine is not fitted, SettingsError for less than one centre or
    fewer rows.
    """
    machine._check_fitted()
    rows = as_rows(x).to(machine.centres.device)
    if centres < 1 or len(rows) < 8:
        raise SettingsError(
            f"a reduced set needs 1 centre and 8 rows, not {centres} and {len(rows)}"
        )
    kind = machine.centres.dtype
    gamma, pool = float(machine.gamma_value), machine.centres.double()
    picked = pivots(pool, gamma, min(centres, len(pool)))
    test = torch.arange(len(rows), device=rows.device) % 4 == 3
    smaller, best = None, torch.inf
    design = torch.nn.functional.pad(rbf(rows[~test], pool[picked], gamma), (0, 1), value=1.0)
    with torch.no_grad():
        truth = machine.values(rows.to(kind)).double()
        for ridge in _RIDGES:
            weights = _least_squares(design, truth[~test], ridge)
            attempt = deepcopy(machine)
            attempt.centres, attempt.support = machine.centres[picked], machine.support[picked]
            attempt.weights, attempt.bias = weights[:-1].to(kind), weights[-1].to(kind)
            # It is no longer the dual problem's solution.
            attempt.gap = torch.full_like(machine.gap, torch.inf)
            loss = (attempt.values(rows[test].to(kind)).double() - truth[test]).abs().mean()
            if float(loss) < best:
                smaller, best = attempt, float(loss)
    if smaller is None:
        raise SettingsError("no ridge gave finite values; ask for fewer centres")
    return smaller


def _least_squares(design: Tensor, truth: Tensor, ridge: float) -> Tensor:
    """Ridge regression (m, k) of truth (n, k) on design (n, m) by QR of the stacked system."""
    size = design.shape[1]
    penalty = (ridge * len(design) ** 0.5) * torch.eye(size).to(design)
    penalty[-1, -1] = 0
    stacked = torch.cat([design, penalty])
    q, r = torch.linalg.qr(stacked)
    right = torch.cat([truth, truth.new_zeros(size, truth.shape[1])])
    return torch.linalg.solve_triangular(r, q.T @ right, upper=True)
