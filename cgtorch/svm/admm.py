"""Operator splitting for batches of the dual problems of C-SVC and epsilon-SVR on one kernel.

The alternating direction method of multipliers (Boyd et al. 2011, over-relaxed as in its section
3.4.3) splits the coefficients in two that become equal: x meets the quadratic function and the sum,
z the box and |beta|. A fold's held-out rows have the box [0, 0], so one inverse of K + rho serves
every fold, C and output, and an iteration of all problems is one product with it. These products
are in float32, of changes only; each round of iterations begins with residuals in float64, which
say how optimal z is and take the errors of the round before out of x.

Within some dozen iterations the statuses of the coefficients are nearly right, long before their
values are; a few exact Newton steps on these statuses (`cgtorch.svm.polish`) give the values.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.svm.gram import Gram
from cgtorch.svm.inverses import Factored, Inverse, inverse, low_rank
from cgtorch.svm.polish import polish
from cgtorch.svm.problems import Problems, violation
from cgtorch.svm.smoothed_loss import soft

_LADDER = 8.0  # rho is a power of it
_RELAX = 1.6
_ROUND = 40  # iterations between two checks, twice as many where they cost little
_ROUNDS = 30
_SEVERAL = 16  # rows for each problem, above which one inverse has to do for all
_CHEAP = 150  # products with K that an exact try may cost for each round of splitting before it
_UNEVEN = 8.0  # rho changes where one residual is so many times the other
_CONDITION = 1e6  # of the largest inverse, so that float32 holds it
_KEPT = 5  # inverses kept, of n^2 numbers each


@dataclass(frozen=True)
class Split:
    """Where each of P problems over n rows stands.

    Attributes:
        beta: Coefficients (P, n) in their boxes, z of the splitting; at the end their sum is 0.
        slope: rho times the scaled multipliers (P, n), slopes of epsilon |beta| and the box.
        bias: Biases (P,).
        violation: Largest violation of the optimality conditions (P,), in units of z.
    """

    beta: Tensor
    slope: Tensor
    bias: Tensor
    violation: Tensor


def split(gram: Gram, problems: Problems, tolerance: float) -> Split:
    """Iterate until each of P problems violates its optimality conditions by at most `tolerance`.

    Args:
        gram: Kernel values among n rows, positive semidefinite.
        problems: P problems over the rows.
        tolerance: Violation at which a problem is solved, as libsvm counts it.

    Returns:
        Where the problems stand; those that violate more are not solved.
    """
    zero = torch.zeros_like(problems.z)
    found = Split(zero, zero.clone(), zero[:, 0].clone(), torch.full_like(zero[:, 0], torch.inf))
    scale = max(float(gram.matrix.diagonal().mean()), 1e-12)
    least = math.ceil(math.log(scale * len(gram) / _CONDITION, _LADDER))
    level = (0.5 * (scale / problems.cap).sqrt()).log() / math.log(_LADDER)
    factor = low_rank(gram.matrix)
    # A whole inverse costs as much as n / P iterations: only many problems pay for several.
    alone = factor is None and len(gram) > _SEVERAL * len(zero)
    level = (level.mean().expand_as(level) if alone else level).round()
    level = level.clamp_min(least)
    live = torch.arange(len(zero), device=zero.device)
    kept: dict[float, Inverse] = {}
    for number in range(_ROUNDS + 1):
        rest: list[Tensor] = []
        if number:
            worth = number * _CHEAP * len(gram) ** 2
            live = _polish(gram, problems, found, live, tolerance, worth)
        levels = level[live]
        for power in levels.unique().tolist():
            shifted = _kept(kept, gram, factor, power)
            rows = live[levels == power]
            x = _check(gram, problems.take(rows), shifted, found, rows)
            go = found.violation[rows] > tolerance
            if number < _ROUNDS and bool(go.any()):
                rows = rows[go]
                step = _iterate(problems.take(rows), shifted, found, rows, x[go])
                level[rows] = (level[rows] + step * (not alone or number > 1)).clamp_min(least)
                rest.append(rows)
        if not rest:
            break
        live = torch.cat(rest)
    return replace(found, beta=_balanced(problems, found.beta))


def _polish(
    gram: Gram, problems: Problems, found: Split, live: Tensor, tolerance: float, worth: float
) -> Tensor:
    """The problems of `live` that a try at their exact solutions leaves unsolved.

    Those whose cubed number of free coefficients is above `worth` are not tried.
    """
    part = problems.take(live)
    free = _free(part, found.beta[live]).sum(1)
    cheap = free.double() ** 3 <= worth
    tried = live[cheap]
    if len(tried) == 0:
        return live
    exact = polish(gram, part.take(cheap), found.beta[tried], found.bias[tried], tolerance)
    rows = tried[exact.solved]
    found.beta[rows], found.bias[rows] = exact.beta[exact.solved], exact.bias[exact.solved]
    found.violation[rows] = tolerance
    return torch.cat([live[~cheap], tried[~exact.solved]]).sort().values


def _free(problems: Problems, beta: Tensor) -> Tensor:
    """Which coefficients (P, n) touch neither a bound nor 0."""
    return (beta > problems.lower) & (beta < problems.upper) & (beta != 0)


def _kept(kept: dict[float, Inverse], gram: Gram, factor: Tensor | None, power: float) -> Inverse:
    """The inverse for rho = ladder ** power, from those kept or new in the place of the oldest."""
    if power not in kept:
        if len(kept) == _KEPT:
            del kept[next(iter(kept))]
        kept[power] = inverse(gram.matrix, factor, _LADDER**power)
    return kept[power]


def _check(gram: Gram, problems: Problems, inverse: Inverse, found: Split, rows: Tensor) -> Tensor:
    """Write biases and violations of the problems `rows`, and give x that belongs to their z.

    x - z solves (K + rho) (x - z) + bias = z-residual - slope with sum(x) = 0.
    """
    beta = found.beta[rows]
    residual = problems.z - gram.times(beta)
    right, excess = residual - found.slope[rows], beta.sum(1)
    bias = (right @ inverse.rows + excess) / inverse.total
    found.bias[rows] = bias
    # What the sum lacks, shared out to the free coefficients, changes residuals by about so much.
    lack = excess.abs() * gram.matrix.diagonal().mean() / _free(problems, beta).sum(1).clamp_min(1)
    wrong = violation(problems, beta, residual - bias[:, None])
    found.violation[rows] = torch.maximum(wrong, lack)
    change = inverse.add(torch.zeros_like(beta).float(), (right / inverse.rho).float())
    share = (excess / inverse.total).float()[:, None] * inverse.rows.float()
    return change - share + beta.float()


def _balanced(problems: Problems, beta: Tensor) -> Tensor:
    """Coefficients (P, n) in their boxes whose free ones are moved so that the sum is 0."""
    inside = _free(problems, beta)
    shift = beta.sum(1) / inside.sum(1).clamp_min(1)
    moved = torch.where(inside, beta - shift[:, None], beta)
    return torch.minimum(torch.maximum(moved, problems.lower), problems.upper)


def _iterate(problems: Problems, inverse: Inverse, found: Split, rows: Tensor, x: Tensor) -> Tensor:
    """One round of iterations for the problems `rows` from x (P, n).

    Gives by how much rho's power (P,) should change: up where x and z differ more than z moves,
    down where less.
    """
    rho = inverse.rho
    lower, upper, width = (
        part.float() for part in (problems.lower, problems.upper, problems.epsilon / rho)
    )
    z, u = found.beta[rows].float(), (found.slope[rows] / rho).float()
    pull = z - u
    for _ in range(_ROUND * (1 + isinstance(inverse, Factored))):
        v = torch.add(u, x, alpha=_RELAX).add_(z, alpha=1 - _RELAX)
        before, z = z, torch.minimum(torch.maximum(soft(v, width), lower), upper)
        u = v - z
        apart, former, pull = x - z, pull, z - u
        x = inverse.add(x, pull - former)
    found.beta[rows], found.slope[rows] = z.double(), u.double() * rho
    far = apart.norm(dim=1) / z.norm(dim=1).clamp_min(1e-30)
    moved = (z - before).norm(dim=1) / u.norm(dim=1).clamp_min(1e-30)
    uneven = (far / moved.clamp_min(1e-30)).log() / math.log(_UNEVEN)
    return uneven.clamp(-1, 1).trunc().to(rows.device, torch.float64)
