"""Operator splitting for batches of the dual problems of C-SVC and epsilon-SVR on one kernel.

The alternating direction method of multipliers (Boyd et al. 2011, over-relaxed as in its section
3.4.3) splits the coefficients in two that become equal: x meets the quadratic function and the sum,
z the box and |beta|. A fold's held-out rows have the box [0, 0], so one inverse of K + rho serves
every fold, C and output, and an iteration of all problems is one product with it. These products
are in float32, of changes only; each round of iterations begins with residuals in float64, which
say how optimal z is and take the errors of the round before out of x.

It converges in some hundred iterations where many eigenvalues of K are above rho, as they are where
many coefficients are free. Where few are it is slow, and Newton's method fast.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.models.gram import Gram
from cgtorch.models.problems import Problems
from cgtorch.models.rounded import soft

_LADDER = 8.0  # rho is a power of it
_RELAX = 1.6
_ROUND = 20  # iterations between two checks
_ROUNDS = 60
_EARLY, _NEAR, _FREE = 4, 0.1, 0.125  # who violates more after so many rounds with so few free
_LATE, _FAR = 15, 0.1  # and who violates more after so many, is left
_DIMENSION, _MANY = 0.15, 50  # least mean effective dimension for so many problems, in rows
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


@dataclass(frozen=True)
class _Inverse:
    """(K + rho)^-1: projected on sums of 0 (n, n), its row sums before that (n,) and their sum."""

    rho: float
    projected: Tensor
    rows: Tensor
    total: Tensor


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
    level = level.round().clamp_min(least)
    # An iteration reads the whole inverse, so it pays for many problems sooner than for few.
    least_dimension = len(gram) * min(_DIMENSION, _DIMENSION * _MANY / len(zero))
    pays = bool(_dimension(gram, _LADDER**level).mean() >= least_dimension)
    live = torch.arange(len(zero) if pays else 0, device=zero.device)
    kept: dict[float, _Inverse] = {}
    for number in range(_ROUNDS + 1):
        rest = []
        for power in level[live].unique().tolist():
            inverse = _kept(kept, gram, power)
            rows = live[level[live] == power]
            x = _check(gram, problems.take(rows), inverse, found, rows)
            go = found.violation[rows] > tolerance
            if number >= _EARLY:
                go &= _hopeful(problems, found, rows)
            if number >= _LATE:
                go &= found.violation[rows] <= _FAR
            if number < _ROUNDS and bool(go.any()):
                rows = rows[go]
                step = _iterate(problems.take(rows), inverse, found, rows, x[go])
                level[rows] = (level[rows] + step).clamp_min(least)
                rest.append(rows)
        if not rest:
            break
        live = torch.cat(rest)
    return replace(found, beta=_balanced(problems, found.beta))


def _dimension(gram: Gram, rho: Tensor) -> Tensor:
    """Effective dimension (P,) of K at rho (P,), the trace of K (K + rho)^-1, by every fourth row.

    About so many coefficients can be free.
    """
    values = 4 * torch.linalg.eigvalsh(gram.matrix[::4, ::4].contiguous()).clamp_min(0)
    return (values / (values + rho[:, None])).sum(1)


def _hopeful(problems: Problems, found: Split, rows: Tensor) -> Tensor:
    """Whether problems `rows` are nearly solved or have so many free ones that Newton's is slow."""
    free = _free(problems.take(rows), found.beta[rows])
    return (found.violation[rows] <= _NEAR) | (free.sum(1) >= _FREE * free.shape[1])


def _free(problems: Problems, beta: Tensor) -> Tensor:
    """Which coefficients (P, n) touch neither a bound nor 0."""
    return (beta > problems.lower) & (beta < problems.upper) & (beta != 0)


def _kept(kept: dict[float, _Inverse], gram: Gram, power: float) -> _Inverse:
    """The inverse for rho = ladder ** power, from those kept or new in the place of the oldest."""
    if power not in kept:
        if len(kept) == _KEPT:
            del kept[next(iter(kept))]
        kept[power] = _inverse(gram.matrix, _LADDER**power)
    return kept[power]


def _inverse(matrix: Tensor, rho: float) -> _Inverse:
    """The inverse of K + rho, in float32 if it can be."""
    for kind in (torch.float32, torch.float64):
        shifted = matrix.to(kind, copy=True)
        shifted.diagonal().add_(rho)
        factor, info = torch.linalg.cholesky_ex(shifted)
        if int(info) == 0:
            break
    whole = torch.cholesky_inverse(factor).float()
    rows = whole.sum(1)
    total = rows.sum()
    return _Inverse(rho, whole.addr_(rows, rows / -total), rows.double(), total.double())


def _check(gram: Gram, problems: Problems, inverse: _Inverse, found: Split, rows: Tensor) -> Tensor:
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
    change = right.float() @ inverse.projected
    share = (excess / inverse.total).float()[:, None] * inverse.rows.float()
    return change - share + beta.float()


def _balanced(problems: Problems, beta: Tensor) -> Tensor:
    """Coefficients (P, n) in their boxes whose free ones are moved so that the sum is 0."""
    inside = _free(problems, beta)
    shift = beta.sum(1) / inside.sum(1).clamp_min(1)
    moved = torch.where(inside, beta - shift[:, None], beta)
    return torch.minimum(torch.maximum(moved, problems.lower), problems.upper)


def violation(problems: Problems, beta: Tensor, residual: Tensor) -> Tensor:
    """The largest distance (P,) of residuals z - K beta - bias (P, n) from what beta allows."""
    width = problems.epsilon[:, None]
    most = torch.where(beta >= 0, width, -width).masked_fill(beta >= problems.upper, torch.inf)
    least = torch.where(beta <= 0, -width, width).masked_fill(beta <= problems.lower, -torch.inf)
    return torch.maximum(residual - most, least - residual).amax(1).clamp_min(0)


def _iterate(
    problems: Problems, inverse: _Inverse, found: Split, rows: Tensor, x: Tensor
) -> Tensor:
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
    for _ in range(_ROUND):
        v = torch.add(u, x, alpha=_RELAX).add_(z, alpha=1 - _RELAX)
        before, z = z, torch.minimum(torch.maximum(soft(v, width), lower), upper)
        u = v - z
        apart, former, pull = x - z, pull, z - u
        x = torch.addmm(x, pull - former, inverse.projected, alpha=rho)
    found.beta[rows], found.slope[rows] = z.double(), u.double() * rho
    far = apart.norm(dim=1) / z.norm(dim=1).clamp_min(1e-30)
    moved = (z - before).norm(dim=1) / u.norm(dim=1).clamp_min(1e-30)
    uneven = (far / moved.clamp_min(1e-30)).log() / math.log(_UNEVEN)
    return uneven.clamp(-1, 1).trunc().to(rows.device, torch.float64)
