"""The dual problems of a cross-validated grid at one gamma, solved together.

One kernel matrix serves every fold, every C, every epsilon and every output: a fold only fixes its
held-out coefficients to 0, and their decision values come free as K beta + b.
"""

from dataclasses import dataclass, replace
from functools import cache, partial

import torch
from torch import Tensor

from cgtorch.svm.admm import split
from cgtorch.svm.compiled_smo import Stand, at_zero, compiled_gram
from cgtorch.svm.gram import Gram, gram
from cgtorch.svm.kernels import Kernel
from cgtorch.svm.problems import Problems, classification, regression
from cgtorch.svm.solver import (
    descend,
    dual_objective,
    duality_gap,
    middle_bias,
    quarter_start,
    solve,
)
from cgtorch.svm.warm_started_path import solve_chains

GRID_RIDGE = 1e-3
TOLERANCE = 1e-3  # violation of the optimality conditions, as libsvm's default
_BATCH = 64
"""Problems that Newton's method solves together, few enough to stay in the processor's cache."""


@dataclass(frozen=True)
class Task:
    """What the cells of a grid share.

    Attributes:
        kernel: Kernel as `SVC` and `SVR` take it, with `degree` and `coef0`.
        rows: Training rows (n, d).
        targets: Signs, or targets in units of their own (K, n).
        unit: These units (K,), 1 for signs.
        weight: Weights of the rows (1 + F, n), first of all rows and then of each fold's.
        folds: Fold number of each row (n,).
        costs: Costs, ascending (N,).
        tubes: Half widths of the tube (E,).
        classifier: Whether the problems are those of classification.
    """

    kernel: str | Kernel
    degree: int
    coef0: float
    rows: Tensor
    targets: Tensor
    unit: Tensor
    weight: Tensor
    folds: Tensor
    costs: Tensor
    tubes: Tensor
    classifier: bool

    def index(self) -> Tensor:
        """Numbers (P, 3) of cost, output and block of `weight` of all problems of a fold."""
        axes = len(self.costs), len(self.targets), len(self.weight) - 1
        index = torch.cartesian_prod(*(torch.arange(size) for size in axes)).to(self.folds.device)
        index[:, 2] += 1
        return index

    def problems(self, index: Tensor, tube: Tensor) -> Problems:
        """The problems of `index` (P, 3): numbers of cost, output and block of `weight`."""
        cap, weight = self.costs[index[:, 0]], self.weight[index[:, 2]]
        if self.classifier:
            return classification(self.targets[0], cap, weight)
        unit = self.unit[index[:, 1]]
        return regression(self.targets[index[:, 1]], cap / unit, tube / unit, weight)


@dataclass(frozen=True)
class Cells:
    """Answers at one gamma.

    Attributes:
        held_out: Decision value of each row from the fold that held it out (E, N, K, n), in the
            task's units.
        gap: Largest relative duality gap of a cell's folds (E, N, K).
        direct: False where a fold of the cell had to be finished by plain SMO (E, N, K).
    """

    held_out: Tensor
    gap: Tensor
    direct: Tensor


def solve_width(task: Task, width: float, generator: torch.Generator, threads: int = 1) -> Cells:
    """All cells at one gamma; how many threads compiled code has changes no result."""
    kernel = task.kernel, task.rows, width, task.degree, task.coef0
    matrix = compiled_gram(*kernel, threads)
    exact = cache(partial(gram, *kernel))  # not needed where compiled code solves everything

    def solved(tube: Tensor) -> Cells:
        index = task.index()
        problems = task.problems(index, tube)
        found = at_zero(problems)
        if matrix is not None:
            found = solve_chains(matrix, exact, problems, len(task.costs), TOLERANCE, threads)
        direct = torch.ones_like(found.bias, dtype=torch.bool)
        rest = (found.violation > TOLERANCE).nonzero().flatten()
        if len(rest):
            direct[rest] = _finish(task, exact(), tube, index, found, rest, generator)
        bias = middle_bias(problems, found.beta, found.bias, found.product)
        return _cells(task, problems, replace(found, bias=bias), direct)

    columns = zip(*(vars(solved(tube)).values() for tube in task.tubes), strict=True)
    return Cells(*(torch.stack(column) for column in columns))


def _finish(
    task: Task,
    kernel: Gram,
    tube: Tensor,
    index: Tensor,
    found: Stand,
    rows: Tensor,
    generator: torch.Generator,
) -> Tensor:
    """Solve the problems `rows` (R,) of `index` (P, 3), and say which needed no plain SMO (R,).

    By splitting, and by Newton's method what that leaves.
    """
    other = split(kernel, task.problems(index[rows], tube), TOLERANCE)
    beta, bias = other.beta, other.bias
    direct = torch.ones_like(bias, dtype=torch.bool)
    rest = (other.violation > TOLERANCE).nonzero().flatten()
    if len(rest):
        left = _newton(task, kernel, tube, index[rows[rest]], generator)
        beta[rest], bias[rest], direct[rest] = left
    found.beta[rows], found.bias[rows], found.product[rows] = beta, bias, kernel.times(beta)
    return direct


def _newton(
    task: Task, kernel: Gram, tube: Tensor, index: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients (P, n), biases and directness (P,) of the problems of `index` (P, 3).

    The folds start from the same problems on all rows, solved roughly.
    """
    pairs, place = index[:, :2].unique(dim=0, return_inverse=True)
    whole = task.problems(torch.nn.functional.pad(pairs, (0, 1)), tube)
    rough = descend(kernel, whole, quarter_start(kernel, whole, generator))
    parts = []
    for rows in torch.arange(len(index), device=index.device).split(_BATCH):
        at = place[rows]
        start = rough.beta[at], rough.bias[at], rough.status[at]
        problems = task.problems(index[rows], tube)
        part = solve(kernel, problems, generator, start, last=GRID_RIDGE)
        parts.append((part.beta, part.bias, part.direct))
    beta, bias, direct = (torch.cat(column) for column in zip(*parts, strict=True))
    return beta, bias, direct


def _cells(task: Task, problems: Problems, found: Stand, direct: Tensor) -> Cells:
    """Solutions (P,) in the order of the task's index as cells."""
    shape = len(task.costs), len(task.targets), -1
    value = (found.product + found.bias[:, None]).reshape(*shape, len(task.rows))
    gap = duality_gap(problems, found.beta, found.bias, found.product)
    gap = gap / dual_objective(problems, found.beta, found.product).abs().clamp_min(1e-12)
    place = task.folds.to(value.device).expand(*shape[:2], 1, -1)
    return Cells(
        value.gather(2, place).squeeze(2),
        gap.reshape(shape).amax(-1),
        direct.reshape(shape).all(-1),
    )
