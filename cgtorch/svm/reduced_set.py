"""Smaller machines: fewer centres with nearly the same values, or fewer training rows.

A reduced set has the centres that pivoted Cholesky decomposition (Fine & Scheinberg 2001) greedily
picks as those that the others explain least. A coreset keeps support vectors, without which the
solution would change, and the rows farthest from all kept ones.
"""

from copy import deepcopy
from typing import TypeVar

import torch
from torch import Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.svm.inputs import as_rows
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.rbf import rbf

Machine = TypeVar("Machine", bound=KernelMachine)

_FLOOR = 1e-12  # below which the rest is rounding
_RIDGES = tuple(10.0**-power for power in range(1, 11))


def fit_reduced_set(machine: Machine, centres: int, x: Tensor) -> Machine:
    """A machine with at most `centres` centres, fitted to the values of a fitted one on rows x.

    The rows (n, d) should be at least 8 from the region where the machine will be used. Three
    quarters of them fit the weights. The others choose the ridge, in the machine's type, so that no
    weight is too large for it. ModelError if the machine is not fitted, SettingsError for less than
    one centre or fewer rows.
    """
    machine.check_fitted()
    rows = as_rows(x).to(machine.centres.device)
    if centres < 1 or len(rows) < 8:
        raise SettingsError(
            f"a reduced set needs 1 centre and 8 rows, not {centres} and {len(rows)}"
        )
    kind = machine.centres.dtype
    gamma, pool = float(machine.gamma_value), machine.centres.double()
    picked = pivots(pool, gamma, min(centres, len(pool)))
    test = torch.arange(len(rows)) % 4 == 3
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


def pivots(x: Tensor, gamma: float, count: int) -> Tensor:
    """Indices (at most count,) of rows x (n, d), picked by pivoted Cholesky decomposition."""
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


def _least_squares(design: Tensor, truth: Tensor, ridge: float) -> Tensor:
    """Ridge regression (m, k) of `truth` (n, k) on `design` (n, m), by QR of the stacked system."""
    size = design.shape[1]
    penalty = (ridge * len(design) ** 0.5) * torch.eye(size).to(design)
    penalty[-1, -1] = 0
    q, r = torch.linalg.qr(torch.cat([design, penalty]))
    right = torch.cat([truth, truth.new_zeros(size, truth.shape[1])])
    return torch.linalg.solve_triangular(r, q.T @ right, upper=True)


def coreset(rows: Tensor, keep: Tensor, limit: int) -> Tensor:
    """Indices, ascending, of at most `limit` of the rows (n, d).

    Rows in `keep` (n,) bool, such as support vectors, come first; if they are too many, the choice
    is among them. By the greedy k-centre of Gonzalez (1985) no other row is farther from a kept one
    than twice the optimum. SettingsError for a limit below 1.
    """
    if limit < 1:
        raise SettingsError(f"the coreset's limit is {limit}; keep at least 1 row")
    everything = torch.arange(len(rows), device=rows.device)
    if len(rows) <= limit:
        return everything
    chosen, pool = everything[keep], everything[~keep]
    if len(chosen) > limit:
        chosen, pool = everything[:0], chosen
    more = _farthest_first(rows[pool], rows[chosen], limit - len(chosen))
    return torch.cat([chosen, pool[more]]).sort().values


def _farthest_first(rows: Tensor, covered: Tensor, count: int) -> Tensor:
    """Indices (count,) of rows (n, d), each farthest from `covered` (m, d) and the rows before."""
    if len(covered):
        nearest = torch.cdist(rows, covered).amin(1)
    else:
        nearest = -(rows - rows.mean(0)).norm(dim=1)
    chosen = []
    for _ in range(count):
        pick = int(nearest.argmax())
        chosen.append(pick)
        distance = (rows - rows[pick]).norm(dim=1)
        first = len(chosen) == 1 and not len(covered)
        nearest = distance if first else torch.minimum(nearest, distance)
        nearest[pick] = -torch.inf
    return torch.tensor(chosen, dtype=torch.long, device=rows.device)


def shrink_to_coreset(machine: KernelMachine, features: Tensor, limit: int) -> Tensor:
    """Keep at most `limit` training rows (n, d) of a machine, in place; ascending indices (m,)."""
    keep = torch.zeros(len(features), dtype=torch.bool, device=features.device)
    keep[machine.support] = True
    chosen = coreset(features, keep, limit)
    place = torch.searchsorted(chosen, machine.support).clamp_max(len(chosen) - 1)
    kept = chosen[place] == machine.support
    machine.support = place[kept]
    machine.centres, machine.weights = machine.centres[kept], machine.weights[kept]
    return chosen
