"""The dual problems of a cross-validated grid at one gamma, solved together.

One kernel matrix serves every fold, every C, every epsilon and every output: a fold only fixes its
held-out coefficients to 0, and their decision values come free as K beta + b. A solution that
touches no bound of its box holds for every larger C unchanged.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.models.gram import Gram, gram
from cgtorch.models.kernels import Kernel
from cgtorch.models.problems import Problems, classification, regression
from cgtorch.models.solver import (
    Solutions,
    Start,
    descend,
    duality_gap,
    quarter_start,
    solve,
)

GRID_RIDGE = 1e-3
_BATCH = 64  # problems solved together, few enough to stay in the processor's cache


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
        direct: False where a fold of the cell had to be finished by SMO (E, N, K).
    """

    held_out: Tensor
    gap: Tensor
    direct: Tensor


def solve_width(task: Task, width: float, generator: torch.Generator) -> Cells:
    """All cells at one gamma."""
    kernel = gram(task.kernel, task.rows, width, task.degree, task.coef0)
    tubes = [_solve_tube(task, kernel, tube, generator) for tube in task.tubes]
    columns = zip(*(vars(cells).values() for cells in tubes), strict=True)
    return Cells(*(torch.stack(column) for column in columns))


def _solve_tube(task: Task, kernel: Gram, tube: Tensor, generator: torch.Generator) -> Cells:
    """All cells at one gamma and epsilon.

    The folds start from the same problem on all rows, solved roughly. Above the highest cost that
    this makes worth trying, the solution of a fold either holds or starts the next cost; where it
    may have to hold for them, it is as exact as they ask for.
    """
    costs, blocks = len(task.costs), len(task.weight) - 1
    cells = _no_cells(task)
    index, start = _whole(task, kernel, tube, generator)
    top = index.new_zeros(len(task.targets)).scatter_reduce(0, index[:, 1], index[:, 0], "amax")
    index = index.repeat_interleave(blocks, 0)
    index[:, 2] = torch.arange(1, blocks + 1, device=index.device).repeat(len(index) // blocks)
    start = _each(start, lambda part: part.repeat_interleave(blocks, 0))
    while len(index):
        more = torch.zeros(len(index), dtype=torch.bool, device=index.device)
        for rows in torch.arange(len(index), device=index.device).split(_BATCH):
            part, begin = index[rows], _each(start, lambda tensor: tensor[rows])  # noqa: B023
            highest = part[:, 0] >= top[part[:, 1]]
            share = torch.where(highest, task.costs[part[:, 0]] / task.costs[-1], 1.0)
            problems = task.problems(part, tube)
            found = solve(kernel, problems, generator, begin, last=GRID_RIDGE * share)
            until = torch.where(highest & _loose(found.status), costs, part[:, 0] + 1)
            _record(task, tube, cells, part, found, until)
            more[rows] = highest & (until < costs)
            start[0][rows], start[1][rows], start[2][rows] = found.beta, found.bias, found.status
        index, start = index[more], _each(start, lambda tensor: tensor[more])  # noqa: B023
        index[:, 0] += 1
    return cells


def _each(start: Start, change: Callable[[Tensor], Tensor]) -> Start:
    beta, bias, status = start
    return change(beta), change(bias), change(status)


def _no_cells(task: Task) -> Cells:
    shape = len(task.costs), len(task.targets)
    rows = task.rows
    return Cells(
        rows.new_zeros(*shape, len(rows)),
        rows.new_zeros(shape),
        torch.ones(shape, dtype=torch.bool, device=rows.device),
    )


def _record(
    task: Task, tube: Tensor, cells: Cells, index: Tensor, found: Solutions, until: Tensor
) -> None:
    """Write solutions to their cells and to those of larger costs below `until` (P,)."""
    value = found.product + found.bias[:, None]
    for cost in range(len(task.costs)):
        rows = ((index[:, 0] <= cost) & (cost < until)).nonzero().flatten()
        if len(rows) == 0:
            continue
        here = index[rows].clone()
        here[:, 0] = cost
        at = found.take(rows)
        gap = duality_gap(task.problems(here, tube), at.beta, at.bias, at.product)
        relative = gap / at.objective.abs().clamp_min(1e-12)
        for row, (_, output, block), error in zip(rows, here.tolist(), relative, strict=True):
            inside = task.folds == block - 1
            cells.held_out[cost, output, inside] = value[row, inside]
            cells.gap[cost, output] = torch.maximum(cells.gap[cost, output], error)
            cells.direct[cost, output] &= found.direct[row]


def _whole(
    task: Task, kernel: Gram, tube: Tensor, generator: torch.Generator
) -> tuple[Tensor, Start]:
    """Problems on all rows, (P, 3), that start the folds, and their rough solutions.

    They are tried on a quarter of the rows first, and either way for every output those are left
    out that have a larger C than one that touches no bound.
    """
    axes = [torch.arange(size) for size in (len(task.costs), len(task.targets), 1)]
    index = torch.cartesian_prod(*axes).to(task.folds.device)
    start = quarter_start(kernel, task.problems(index, tube), generator)
    index, start = _needed(index, start)
    rough = descend(kernel, task.problems(index, tube), start)
    return _needed(index, (rough.beta, rough.bias, rough.status))


def _needed(index: Tensor, start: Start) -> tuple[Tensor, Start]:
    """Those problems (P, 3) and solutions whose C is at most the first that touches no bound."""
    loose = _loose(start[2])
    keep = torch.ones_like(loose)
    for output in index[:, 1].unique():
        mine = index[:, 1] == output
        costs = index[mine & loose, 0]
        if len(costs):
            keep[mine] = index[mine, 0] <= costs.min()
    beta, bias, status = (part[keep] for part in start)
    return index[keep], (beta, bias, status)


def _loose(status: Tensor) -> Tensor:
    """Whether solutions with statuses (P, n) touch no bound of their boxes (P,)."""
    return (status != 0).any(1) & (status.abs() != 2).all(1)
