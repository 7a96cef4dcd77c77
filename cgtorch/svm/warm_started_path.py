"""Problems of rising cost on one kernel, each started from the solution for the cost before.

Compiled SMO ends most of them. Where costs are large and many coefficients free it would take
millions of steps, so from time to time exact steps are tried on the statuses that it has come to
(`cgtorch.svm.polish`), which end a problem long before its values are right.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from cgtorch.svm.compiled_smo import Stand, at_zero, smo_steps
from cgtorch.svm.gram import Gram
from cgtorch.svm.polish import polish
from cgtorch.svm.problems import Problems

_WORTH = 1 / 80, 5e6
"""Kernel values of the first turn: a share of n^3, as the cost of a factor, and some more."""
_TURNS = 4  # each twice as long as the one before


def solve_chains(
    matrix: Tensor,
    exact: Callable[[], Gram],
    problems: Problems,
    costs: int,
    tolerance: float,
    threads: int,
) -> Stand:
    """Solve problems that come in blocks of equal length, one for each cost.

    Args:
        matrix: Kernel matrix of `compiled_smo.compiled_gram` (n, stride).
        exact: Gives the same in float64 where that is needed.
        problems: P problems over n rows, those of the smallest cost first and every block in the
            same order; boxes are in proportion to `cap`.
        costs: Number of blocks.
        tolerance: Violation at which a problem is solved, as libsvm counts it.
        threads: How many share out the problems of a cost, which changes no result.

    Returns:
        Where the problems stand; those that violate more are not solved.
    """
    blocks: list[Stand] = []
    rows = torch.arange(len(problems.z)).chunk(costs)
    for number, index in enumerate(rows):
        block = problems.take(index)
        start = at_zero(block)
        if number:
            before = problems.take(rows[number - 1])
            start = _scaled(before, blocks[-1], block)
        blocks.append(_solve(matrix, exact, block, start, tolerance, threads))
    parts = zip(*(vars(block).values() for block in blocks), strict=True)
    return Stand(*(torch.cat(part) for part in parts))


def _solve(
    matrix: Tensor,
    exact: Callable[[], Gram],
    problems: Problems,
    start: Stand,
    tolerance: float,
    threads: int,
) -> Stand:
    """Problems from their start by SMO and exact steps in turns."""
    worth = _WORTH[0] * len(matrix) ** 3 + _WORTH[1]
    found, left = start, torch.arange(len(start.bias))
    for turn in range(_TURNS):
        part = problems.take(left)
        here = smo_steps(matrix, part, found.take(left), tolerance, worth * 2**turn, threads)
        found.put(left, here)
        rest = here.violation > tolerance
        left, part, here = left[rest], part.take(rest), here.take(rest)
        if len(left) == 0:
            break
        tried = polish(exact(), part, here.beta, here.bias, tolerance)
        yes = tried.solved
        product = exact().times(tried.beta[yes])
        done = torch.full_like(tried.bias[yes], tolerance)
        found.put(left[yes], Stand(tried.beta[yes], product, tried.bias[yes], done))
        left = left[~yes]
        if len(left) == 0:
            break
    return found


def _scaled(before: Problems, found: Stand, problems: Problems) -> Stand:
    """A start from solutions for smaller costs, times a number from 1 to the ratio of the costs.

    It is the best such number; at the ratio, coefficients on a bound are on it again.
    """
    ratio = problems.cap / before.cap
    linear = (before.z * found.beta - before.epsilon[:, None] * found.beta.abs()).sum(1)
    square = (found.product * found.beta).sum(1)
    length = torch.where(square > 0, linear / square.clamp_min(1e-300), ratio)
    length = torch.minimum(length.clamp_min(1), ratio)[:, None]
    beta, whole = found.beta * length, length == ratio[:, None]
    beta = torch.where(whole & (found.beta == before.upper), problems.upper, beta)
    beta = torch.where(whole & (found.beta == before.lower), problems.lower, beta)
    beta = torch.minimum(torch.maximum(beta, problems.lower), problems.upper)
    unknown = torch.full_like(ratio, torch.inf)
    return Stand(beta, found.product * length, found.bias.clone(), unknown)
