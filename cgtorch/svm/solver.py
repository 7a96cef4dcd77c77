"""Solving batches of the dual problems of C-SVC and epsilon-SVR (`cgtorch.svm.problems`).

Sequential minimal optimisation (compiled, or plain without a compiler) solves most of them. With
large costs and many free coefficients, or for an exact solution, it would take millions of steps.
So runs of it alternate with exact steps from their statuses (`cgtorch.svm.polish`). The runs get
longer and longer, and the last one has no limit.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.ground.errors import ModelError
from cgtorch.svm.gram import Gram
from cgtorch.svm.polish import polish
from cgtorch.svm.problems import Problems, State, at_zero, feasible, middle_bias, relative_gap
from cgtorch.svm.smo import compiled_smo_steps, smo_steps

EXACT = 1.25e-8
"""The tolerance of a final fit: a relative duality gap of about 1e-7."""

ROUGH = 1e-3
"""The tolerance where scores are compared, as libsvm's default."""

_WORTH = 1 / 80, 5e6
"""Kernel values of the first run: a share of n^3, as the cost of a factor, and a constant."""
_TURNS = 4  # each twice as long as the one before, to a tenth of its violation
_ENDLESS = 2e7  # steps of the last one
_ROUNDING = 1e-12  # of C, below which no violation can be told
_OFF = 0.01  # relative duality gap of what has not been solved


def start_at(gram: Gram, problems: Problems, beta: Tensor) -> State:
    """A start at the feasible point nearest to coefficients (P, n)."""
    start = at_zero(problems)
    beta = feasible(problems, beta)
    product = (beta.cpu() @ gram.matrix).to(beta)
    return State(beta, product, start.bias, start.violation)


def solve(
    gram: Gram, problems: Problems, start: State | None = None, tolerance: float = EXACT
) -> State:
    """Feasible solutions of P problems, computed on the CPU, wherever their tensors are.

    They start from feasible coefficients, if given, and violate no condition of optimality by more
    than the tolerance, as defined in libsvm. ModelError if a problem could not be solved.
    """
    device, cpu = problems.z.device, torch.device("cpu")
    problems, left = problems.to(cpu), torch.arange(len(problems.z))
    found = at_zero(problems) if start is None else start.to(cpu).take(left)  # a copy
    tolerance = max(tolerance, _ROUNDING * float(problems.cap.max()))
    for turn in range(_TURNS + 1):
        part = problems.take(left)
        here = _smo(gram, part, found.take(left), tolerance, turn)
        rest = (here.violation > tolerance).nonzero().flatten()
        if turn < _TURNS and len(rest):
            _polish(gram, part, here, rest, tolerance)
        found.put(left, here)
        left = left[here.violation > tolerance]
        if len(left) == 0:
            break
    if len(left):
        _check(problems.take(left), found.take(left))
    return replace(found, bias=middle_bias(problems, found)).to(device)


def _smo(gram: Gram, problems: Problems, start: State, tolerance: float, turn: int) -> State:
    """The problems after a run of minimal optimisation."""
    last, n = turn == _TURNS, len(gram)
    aim = tolerance if last else max(tolerance, ROUGH * 0.1**turn)
    worth = _ENDLESS * n if last else (_WORTH[0] * n**3 + _WORTH[1]) * 2**turn
    matrix = gram.double if last or tolerance < ROUGH else gram.single
    found = compiled_smo_steps(matrix, problems, start, aim, worth, gram.threads)
    return found or smo_steps(gram.matrix, problems, start, aim, int(worth / n))


def _polish(gram: Gram, problems: Problems, found: State, rows: Tensor, tolerance: float) -> None:
    """Write the results of exact steps for problems `rows` (R,), and exact products, in place."""
    found.product[rows] = found.beta[rows] @ gram.matrix
    for row in rows.tolist():
        exact = polish(gram.matrix, problems.take(row), found.take(row), tolerance)
        if exact is not None:
            found.put(row, exact)


def _check(problems: Problems, found: State) -> None:
    """ModelError if problems are far from solved."""
    gap = relative_gap(problems, found)
    if bool((gap > _OFF).any()):
        raise ModelError(
            f"{len(gap)} dual problems were not solved, with a relative duality gap of "
            f"{float(gap.max()):.2g}; scale the features, lower C, or check that the kernel is "
            "positive semidefinite"
        )
