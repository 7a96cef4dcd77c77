"""The dual problems of a cross-validated grid at one gamma.

One kernel matrix serves every fold, every C, every epsilon and every output: a fold only fixes its
held-out coefficients to 0, and their decision values come free as K beta + b. The problems of each
cost start from the solutions for the cost before.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.optimality import relative_gap
from cgtorch.svm.problems import Problems, State, Targets, inside
from cgtorch.svm.solver import ROUGH, solve


@dataclass(frozen=True)
class Task:
    """What the cells of a grid share.

    Attributes:
        model: Machine with the parameters that all cells have.
        rows: Training rows (n, d).
        targets: What is to be learnt.
        masks: Rows that each fold trains on (F, n).
        folds: Fold number of each row (n,).
        costs: Costs, ascending.
        tubes: Half widths of the tube, 0 alone for a classifier.
    """

    model: KernelMachine
    rows: Tensor
    targets: Targets
    masks: Tensor
    folds: Tensor
    costs: tuple[float, ...]
    tubes: tuple[float, ...]


def solve_width(task: Task, width: float, threads: int) -> tuple[Tensor, Tensor]:
    """Held-out values (E, N, K, n) and relative duality gaps (E, N, K) of all cells at one gamma.

    The values are those of each row from the fold that held it out, in the solver's units; the
    gaps the largest of a cell's folds. No result depends on the number of threads.
    """
    gram = task.model.gram(task.rows, width, threads)
    cells = []
    for tube in task.tubes:
        before: tuple[Problems, State] | None = None
        for cost in task.costs:
            problems = task.model.problems(task.targets, task.masks, cost, tube)
            start = _scaled(*before, problems) if before else None
            found = solve(gram, problems, start, ROUGH)
            cells.append(_cell(task, problems, found))
            before = problems, found
    shape = len(task.tubes), len(task.costs)
    held_out, gap = (torch.stack(part) for part in zip(*cells, strict=True))
    return held_out.unflatten(0, shape), gap.unflatten(0, shape)


def _cell(task: Task, problems: Problems, found: State) -> tuple[Tensor, Tensor]:
    """Held-out values (K, n) and largest relative gap (K,) of solutions (K F)."""
    shape = len(task.targets.y), len(task.masks)
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
