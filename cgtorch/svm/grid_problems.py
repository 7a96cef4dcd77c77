"""The dual problems of a cross-validated grid at one gamma.

One kernel matrix serves every fold, every C, every epsilon and every output: a fold only fixes its
held-out coefficients to 0, and their decision values come free as K beta + b. The problems of each
cost start from the solutions for the cost before.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.svm.gram import Gram
from cgtorch.svm.kernels import Kernel
from cgtorch.svm.optimality import relative_gap
from cgtorch.svm.problems import Problems, State, classification, inside, regression
from cgtorch.svm.solver import ROUGH, solve


@dataclass(frozen=True)
class Task:
    """What the cells of a grid share.

    Attributes:
        kernel: Kernel as `SVC` and `SVR` take it, with `degree` and `coef0`.
        rows: Training rows (n, d).
        targets: Signs, or targets in units of their own (K, n).
        unit: These units (K,), 1 for signs.
        weight: Weights of the rows in each fold (F, n).
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

    def problems(self, cost: Tensor, tube: Tensor) -> Problems:
        """The problems (K F) of a cell: of each output every fold."""
        folds = len(self.weight)
        weight, unit = self.weight.repeat(len(self.unit), 1), self.unit.repeat_interleave(folds)
        if self.classifier:
            return classification(self.targets[0], cost * unit, weight)
        targets = self.targets.repeat_interleave(folds, 0)
        return regression(targets, cost / unit, tube / unit, weight)


@dataclass(frozen=True)
class Cells:
    """Answers at one gamma.

    Attributes:
        held_out: Decision value of each row from the fold that held it out (E, N, K, n), in the
            task's units.
        gap: Largest relative duality gap of a cell's folds (E, N, K).
    """

    held_out: Tensor
    gap: Tensor


def solve_width(task: Task, width: float, threads: int = 1) -> Cells:
    """All cells at one gamma; how many threads compiled code has changes no result."""
    gram = Gram(task.kernel, task.rows, width, task.degree, task.coef0, threads)
    cells = []
    for tube in task.tubes:
        before: tuple[Problems, State] | None = None
        for cost in task.costs:
            problems = task.problems(cost, tube)
            start = _scaled(*before, problems) if before else None
            found = solve(gram, problems, start, ROUGH)
            cells.append(_cell(task, problems, found))
            before = problems, found
    shape = len(task.tubes), len(task.costs)
    held_out, gap = (torch.stack(part) for part in zip(*cells, strict=True))
    return Cells(held_out.unflatten(0, shape), gap.unflatten(0, shape))


def _cell(task: Task, problems: Problems, found: State) -> tuple[Tensor, Tensor]:
    """Held-out values (K, n) and largest relative gap (K,) of solutions (K F)."""
    shape = len(task.unit), len(task.weight)
    value = (found.product + found.bias[:, None]).unflatten(0, shape)
    place = task.folds.to(value.device).expand(shape[0], 1, -1)
    gap = relative_gap(problems, found).unflatten(0, shape)
    return value.gather(1, place).squeeze(1), gap.amax(1)


def _scaled(before: Problems, found: State, problems: Problems) -> State:
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
    unknown = torch.full_like(ratio, torch.inf)
    return State(inside(problems, beta), found.product * length, found.bias.clone(), unknown)
