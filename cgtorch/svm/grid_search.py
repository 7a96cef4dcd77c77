"""Cross-validated choice of C, gamma and epsilon in one batched solve, as exact as libsvm.

One kernel matrix per gamma serves every fold, C, epsilon and output. A fold only fixes its held-out
coefficients to 0, and their decision values K beta + b come at no extra cost. The problems of each
cost start from the solutions for the next smaller cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.ground.processes import in_processes, one_thread_each
from cgtorch.svm import inputs
from cgtorch.svm.folds import fold_numbers, training_masks
from cgtorch.svm.machine import KernelMachine, PerOutput
from cgtorch.svm.problems import Problems, State, Targets, inside, relative_gap
from cgtorch.svm.scores import score_of
from cgtorch.svm.solver import ROUGH, solve


@dataclass(frozen=True)
class Choice:
    """The best hyper-parameters for one output."""

    C: float
    gamma: float
    epsilon: float
    score: float


@dataclass(frozen=True)
class GridResult:
    """Scores of grid points; axes are gamma (G), epsilon (E), C (N), output (K), fold (F), row (n).

    Attributes:
        C: Costs, ascending (N,).
        gamma: Kernel widths (G,).
        epsilon: Tube widths (E,), 0 for a classifier.
        scores: Score on the held-out rows of each fold (G, E, N, K, F), more is better.
        held_out: Decision value of each row from the fold that held it out (G, E, N, K, n).
        gap: Largest relative duality gap of a grid point's solutions (G, E, N, K).
        folds: Fold number of each row (n,).
        best: The best grid point of each output; of equal scores the first, with the smallest C.
    """

    C: Tensor
    gamma: Tensor
    epsilon: Tensor
    scores: Tensor
    held_out: Tensor
    gap: Tensor
    folds: Tensor
    best: tuple[Choice, ...]

    @property
    def mean(self) -> Tensor:
        """Mean score over the folds (G, E, N, K)."""
        return self.scores.mean(-1)


@dataclass(frozen=True)
class _Task:
    """What all grid points share: rows (n, d), masks of training rows (F, n), folds (n,)."""

    model: KernelMachine
    rows: Tensor
    targets: Targets
    masks: Tensor
    folds: Tensor
    costs: tuple[float, ...]
    tubes: tuple[float, ...]


def grid_search(
    model: KernelMachine,
    x: Any,
    y: Any,
    *,
    C: PerOutput,
    gamma: PerOutput,
    epsilon: PerOutput | None = None,
    folds: Any = 5,
    seed: int | Generator = 0,
    scoring: str | None = None,
) -> GridResult:
    """Score every (gamma, epsilon, C) by cross-validation.

    Args:
        model: An `SVC` or `SVR`, whose settings are used where the grid has none.
        x: Rows (n, d).
        y: Labels (n,), or targets (n,) or (n, k).
        C: Costs to try.
        gamma: Kernel widths to try.
        epsilon: Tube widths to try, for `SVR`; the model's own if None.
        folds: Number of folds, or fold numbers (n,).
        seed: Seed or generator of the folds.
        scoring: A name in `SCORES`; accuracy for `SVC` and r2 for `SVR` if None.

    Raises:
        DataError: The model's `fit` would refuse the data, or there are too few rows for the folds.
        SettingsError: An empty grid, a value that is not positive, or an unknown score.
    """
    score = score_of(scoring or model.scoring)
    rows = model.training_rows(x)
    generator = inputs.generator_of(seed)
    costs, widths = tuple(sorted(_axis(C, "C"))), _axis(gamma, "gamma")
    targets = model.targets(y, rows)
    given = model.epsilon if epsilon is None else epsilon
    tubes = (0.0,) if targets.classes is not None else _axis(given, "epsilon")
    numbers = fold_numbers(folds, targets, generator)
    # Nothing needs these numbers any more; what is drawn after them stays what a seed always gave.
    torch.randint(2**62, (len(widths),), generator=generator)
    masks = training_masks(numbers).to(rows.device)
    task = _Task(model, rows, targets, masks, numbers, costs, tubes)
    held_out, gap = _all_widths(task, widths)
    held_out = targets.restored(held_out)
    scores = torch.stack(
        [score(held_out[..., ~mask], targets.y[:, ~mask]) for mask in masks], dim=-1
    )
    C_axis, gamma_axis, tube_axis = (
        torch.tensor(axis, dtype=torch.float64).to(rows) for axis in (costs, widths, tubes)
    )
    best = _best(task, widths, scores)
    return GridResult(C_axis, gamma_axis, tube_axis, scores, held_out, gap, numbers, best)


def _all_widths(task: _Task, widths: Sequence[float]) -> tuple[Tensor, Tensor]:
    """Values (G, E, N, K, n) and gaps (G, E, N, K), for any number of processes."""
    # The largest gammas, which have most support vectors, go first, so that no process ends late.
    order = sorted(range(len(widths)), key=lambda place: -widths[place])

    def work(number: int) -> tuple[Tensor, Tensor]:
        return _solve_width(task, widths[order[number]], threads // processes)

    # The operations are short: torch's own threads would double the time.
    with one_thread_each() as threads:
        most = inputs.MAX_MEMORY // inputs.memory(len(task.rows))
        processes = min(threads, len(widths), most) if task.rows.device.type == "cpu" else 1
        found = in_processes(work, len(widths), processes)
    in_order = [found[order.index(place)] for place in range(len(widths))]
    held_out, gap = (torch.stack(part) for part in zip(*in_order, strict=True))
    return held_out, gap


def _solve_width(task: _Task, width: float, threads: int) -> tuple[Tensor, Tensor]:
    """Held-out values (E, N, K, n) in the solver's units, and largest relative gaps (E, N, K)."""
    gram = task.model.gram(task.rows, width, threads)
    by_fold = len(task.targets.y), len(task.masks)
    place = task.folds.to(task.rows.device).expand(by_fold[0], 1, -1)
    values, gaps = [], []
    for tube in task.tubes:
        before: tuple[Problems, State] | None = None
        for cost in task.costs:
            problems = task.model.problems(task.targets, task.masks, cost, tube)
            start = scaled_start(*before, problems) if before else None
            found = solve(gram, problems, start, ROUGH)
            value = (found.product + found.bias[:, None]).unflatten(0, by_fold)
            values.append(value.gather(1, place).squeeze(1))
            gaps.append(relative_gap(problems, found).unflatten(0, by_fold).amax(1))
            before = problems, found
    shape = len(task.tubes), len(task.costs)
    return torch.stack(values).unflatten(0, shape), torch.stack(gaps).unflatten(0, shape)


def scaled_start(before: Problems, found: State, problems: Problems) -> State:
    """A start from solutions for smaller costs, times the best factor from 1 to the cost ratio."""
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


def _axis(values: Any, name: str) -> tuple[float, ...]:
    """The positive numbers of one axis of the grid, in the given order."""
    given = [values] if isinstance(values, int | float) else list(values)
    if not given:
        raise SettingsError(f"the grid has no value of {name}; give at least one")
    return tuple(inputs.positive(value, name) for value in given)


def _best(task: _Task, widths: Sequence[float], scores: Tensor) -> tuple[Choice, ...]:
    """The best grid point of each output by scores (G, E, N, K, F)."""
    choices = []
    for mean in scores.mean(-1).unbind(-1):
        # torch.unravel_index imports sympy, which takes a second.
        rest, n = divmod(int(mean.argmax()), mean.shape[2])
        g, e = divmod(rest, mean.shape[1])
        choices.append(Choice(task.costs[n], widths[g], task.tubes[e], float(mean[g, e, n])))
    return tuple(choices)
