"""Solving batches of the dual problems of C-SVC and epsilon-SVR (`cgtorch.svm.problems`).

Longer and longer runs of sequential minimal optimisation alternate with exact steps (`polish`), as
with large costs and many free coefficients it alone would take millions of steps. What both leave
is approached by way of easier problems (`continued`), and at last by a bounded number of steps.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.ground.errors import ModelError
from cgtorch.svm.problems import (
    Problems,
    State,
    at_zero,
    inside,
    middle_bias,
    relative_gap,
    violation,
)
from cgtorch.svm.rbf import Gram
from cgtorch.svm.smo import compiled_smo_steps, smo_steps

EXACT = 1.25e-8
"""The tolerance of a final fit: a relative duality gap of about 1e-7."""
ROUGH = 1e-3
"""The tolerance where scores are compared, as libsvm's default."""

_WORTH = 1 / 80, 5e6
"""Kernel values of the first run: a share of n^3, as the cost of a factor, and a constant."""
_TURNS = 4  # each twice as long as the one before, to a tenth of its violation
_ENDLESS = 2e7  # steps of the last one
_LEAST = 1e-12  # of the largest coefficient, below which no violation can be told
_OFF = 0.01  # relative duality gap of what has not been solved
_STEPS = 12  # of Newton's method
_ROUNDING = 0.8  # of the tolerance, by which a ridge may move residuals
_FALL, _FALLS = 10 / 3, 60  # of the tolerance in a continuation: the largest, and their number
_GROWTHS = 3  # of the number of changes there
_SPARSE = 4  # where fewer than one coefficient in so many is not zero, the others are left out


def solve(
    gram: Gram, problems: Problems, start: State | None = None, tolerance: float = EXACT
) -> State:
    """Feasible solutions of P problems, computed on the CPU, wherever their tensors are.

    They start from feasible coefficients, if given, and violate no condition of optimality by more
    than the tolerance, as defined in libsvm: in the unit of z or, where its coefficients cannot be
    as large as 1, in units of the largest. ModelError if a problem could not be solved.
    """
    device, cpu = problems.z.device, torch.device("cpu")
    problems, left = problems.to(cpu), torch.arange(len(problems.z))
    found = at_zero(problems) if start is None else start.to(cpu).take(left)  # a copy
    for turn in range(_TURNS + 1):
        part = problems.take(left)
        here = _smo(gram, part, found.take(left), tolerance, turn)
        allowed = _allowed(part, here, tolerance)
        rest = (here.violation > allowed).nonzero().flatten()
        if turn < _TURNS and len(rest):
            here.product[rest] = here.beta[rest] @ gram.matrix
            for row in rest.tolist():
                one = part.take(row), here.take(row), float(allowed[row])
                exact = polish(gram.matrix, *one)
                if exact is None and turn == _TURNS - 1:
                    exact = continued(gram.matrix, *one)
                if exact is not None and bool(exact.violation < here.violation[row]):
                    here.put(row, exact)
            allowed = _allowed(part, here, tolerance)
        found.put(left, here)
        left = left[here.violation > allowed]
        if len(left) == 0:
            break
    _check(problems.take(left), found.take(left))
    return replace(found, bias=middle_bias(problems, found)).to(device)


def _smo(gram: Gram, problems: Problems, start: State, tolerance: float, turn: int) -> State:
    """The problems after a run of minimal optimisation."""
    last, n = turn == _TURNS, len(gram)
    aim = _allowed(problems, start, tolerance if last else max(tolerance, ROUGH * 0.1**turn))
    worth = _ENDLESS * n if last else (_WORTH[0] * n**3 + _WORTH[1]) * 2**turn
    matrix = gram.double if last or tolerance < ROUGH else gram.single
    found = compiled_smo_steps(matrix, problems, start, aim, worth, gram.threads)
    return found or smo_steps(gram.matrix, problems, start, aim, int(worth / n))


def _allowed(problems: Problems, found: State, tolerance: float) -> Tensor:
    """The violations (P,) that a tolerance allows, and none below what rounding causes."""
    size = problems.reach.clamp_max(1)
    return torch.maximum(tolerance * size, _LEAST * found.beta.abs().amax(1))


def _check(problems: Problems, found: State) -> None:
    """ModelError if problems are far from solved."""
    gap = relative_gap(problems, found)
    if bool((gap > _OFF).any()):
        raise ModelError(
            f"{len(gap)} dual problems were not solved, with a relative duality gap of "
            f"{float(gap.max()):.2g}; scale the features, lower C, or check that the kernel is "
            "positive semidefinite"
        )


def polish(
    kernel: Tensor, problem: Problems, start: State, tolerance: float, growths: int = 0
) -> State | None:
    """The exact solution of a single problem, without the axis of problems, or None.

    This is a primal-dual active set method (Hintermueller, Ito & Kunisch 2003), for a positive
    semidefinite kernel (n, n) and a feasible start whose statuses are nearly right: -2 or 2 on a
    bound, 0 at zero, and -1 or 1 where free below or above zero. Free coefficients solve their
    equations with a small ridge h. It rounds the corners of the loss over a width h C (Chapelle
    2007), so that a residual r determines the coefficient soft(r, epsilon) / h, clipped to its box.
    A solution violates no condition by more than the tolerance; None if the number of changes grows
    more than `growths` times.
    """
    beta, bias, z = start.beta, start.bias, problem.z
    h = _ROUNDING * tolerance / problem.reach
    residual = z - start.product - bias
    status = beta.sign() * (1 + ((beta >= problem.upper) | (beta <= problem.lower)).to(beta))
    before = len(z)
    for _ in range(_STEPS * (1 + growths)):
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
        growths -= flips > before
        if growths < 0:
            return None
        status, before = new, flips
    return None


def continued(kernel: Tensor, problem: Problems, start: State, tolerance: float) -> State | None:
    """The result of `polish`, by continuation (Allgower & Georg 1990), or None.

    A problem with a large tolerance has a large ridge and is easy. Its solution is the start for a
    smaller one, and so on. Where that fails, the next step is shorter. If steps become too many,
    the last solution is returned, whose violation is larger than the tolerance.
    """
    best, factor, aim = None, _FALL, float(problem.reach.clamp_max(1))
    for _ in range(_FALLS):
        found = polish(kernel, problem, best or start, aim, _GROWTHS)
        if found is None and best is None:
            aim *= _FALL
            continue
        if found is not None:
            if aim <= tolerance:
                return found
            best, reached, factor = found, aim, min(_FALL, factor**2)
        else:
            factor = factor**0.5
        aim = max(reached / factor, tolerance)
    return best


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


def _asked(problem: Problems, h: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
    """The coefficients (n,) that residuals determine, and their statuses."""
    width = problem.epsilon
    value = (residual - torch.clamp(residual, -width, width)) / h
    clipped = inside(problem, value)
    return clipped, _statuses(value, clipped)


def _statuses(value: Tensor, clipped: Tensor) -> Tensor:
    """Statuses (n,) of coefficients before and after clipping them to their boxes."""
    return clipped.sign() * (2 - (value == clipped).to(value))


def _with_pivot(problem: Problems, h: Tensor, residual: Tensor, status: Tensor) -> Tensor:
    """Statuses (n,) with one coefficient freed if none is free, as the bias needs an equation.

    It is the first that leaves its bound in the direction of the coefficients' sum.
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

    Free coefficients out of their box become bound, and bound ones on the wrong side become free.
    """
    bound = _statuses(beta, inside(problem, beta))
    bound = bound * (status * bound >= 0)  # from one side to the other only by way of zero
    asked = _asked(problem, h, residual)[1]
    freed = torch.where(status == 0, asked, status).sign()
    return torch.where(status.abs() == 1, bound, torch.where(asked == status, status, freed))
