"""Cross-validated choice of C, gamma and epsilon in one batched exact solve.

One kernel matrix per gamma serves every fold, every C, every epsilon and every output: a fold
only fixes its held-out coefficients to 0, and their decision values come free as K beta + b.
Along C each solution starts from the one before, and a solution that touches no bound holds for
every larger C unchanged.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import torch
from torch import Tensor

from cgtorch.errors import SettingsError
from cgtorch.models import inputs
from cgtorch.models.folds import given_folds, plain_folds, stratified_folds, training_masks
from cgtorch.models.kernels import kernel_matrix, make_kernel
from cgtorch.models.problems import Problems, classification, regression
from cgtorch.models.solver import Solutions, solve
from cgtorch.models.svc import SVC, row_weights
from cgtorch.models.svr import SVR

Progress = Callable[[int, int], None]
"""Called with the number of cells done and of all cells."""

GRID_RIDGE = 1e-3


@dataclass(frozen=True)
class Choice:
    """The best cell for one output."""

    C: float
    gamma: float
    epsilon: float
    score: float


@dataclass(frozen=True)
class GridResult:
    """Scores of every cell; axes are gamma (G), epsilon (E), C (N), output (K), fold (F), row (n).

    Attributes:
        C: Costs, ascending (N,).
        gamma: Kernel widths (G,).
        epsilon: Tube widths (E,), 0 for a classifier.
        scoring: Name of the score.
        scores: Score on the held-out rows of each fold (G, E, N, K, F), more is better.
        held_out: Decision value of each row from the fold that held it out (G, E, N, K, n).
        gap: Largest relative duality gap of a cell's solutions (G, E, N, K).
        direct: False where a fold of the cell had to be finished by SMO (G, E, N, K).
        folds: Fold number of each row (n,).
        best: Best cell of each output.
        common: Best cells of the outputs at the one gamma with the best mean over the outputs.
    """

    C: Tensor
    gamma: Tensor
    epsilon: Tensor
    scoring: str
    scores: Tensor
    held_out: Tensor
    gap: Tensor
    direct: Tensor
    folds: Tensor
    best: tuple[Choice, ...]
    common: tuple[Choice, ...]

    @property
    def mean(self) -> Tensor:
        """Mean score over the folds (G, E, N, K)."""
        return self.scores.mean(-1)


def accuracy(value: Tensor, truth: Tensor) -> Tensor:
    """Share of rows (..., n) whose decision value has the sign of the truth."""
    return ((value > 0) == (truth > 0)).double().mean(-1)


def balanced_accuracy(value: Tensor, truth: Tensor) -> Tensor:
    """Mean over the two classes of the share of their rows that are right."""
    right, positive = (value > 0) == (truth > 0), (truth > 0).expand_as(value)
    first = (right & positive).sum(-1) / positive.sum(-1).clamp_min(1)
    second = (right & ~positive).sum(-1) / (~positive).sum(-1).clamp_min(1)
    return (first.double() + second.double()) / 2


def r2(value: Tensor, truth: Tensor) -> Tensor:
    """Share of the variance of the truth (..., n) that is explained."""
    spread = (truth - truth.mean(-1, keepdim=True)).square().sum(-1)
    return 1 - (value - truth).square().sum(-1) / spread.clamp_min(1e-300)


def neg_mean_absolute_error(value: Tensor, truth: Tensor) -> Tensor:
    """Minus the mean absolute error over rows (..., n)."""
    return -(value - truth).abs().mean(-1)


def neg_mean_squared_error(value: Tensor, truth: Tensor) -> Tensor:
    """Minus the mean squared error over rows (..., n)."""
    return -(value - truth).square().mean(-1)


SCORES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    score.__name__: score
    for score in (accuracy, balanced_accuracy, r2, neg_mean_absolute_error, neg_mean_squared_error)
}


def grid_search(
    model: SVC | SVR,
    x: Any,
    y: Any,
    *,
    C: Sequence[float],
    gamma: Sequence[float],
    epsilon: Sequence[float] | None = None,
    folds: Any = 5,
    seed: int | torch.Generator = 0,
    scoring: str | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> GridResult:
    """Score every (gamma, epsilon, C) by cross-validation.

    Args:
        model: An `SVC` or `SVR` whose kernel, class weights and memory limit are used.
        x: Rows (n, d).
        y: Labels (n,), or targets (n,) or (n, k).
        C: Costs to try.
        gamma: Kernel widths to try.
        epsilon: Tube widths to try, for `SVR`; the model's own if None.
        folds: Number of folds, or fold numbers (n,), or (train, test) pairs.
        seed: Seed or generator of the folds and of the solver.
        scoring: A name in `SCORES`; accuracy for `SVC` and r2 for `SVR` if None.
        workers: Threads that share the gammas out; the result does not depend on their number.
        progress: Called as cells are done with (done, all), one call at a time.

    Returns:
        The scores and the choice.

    Raises:
        DataError: Data that the model's `fit` would refuse, or too few rows for the folds.
        SettingsError: An empty grid, a value that is not positive, or an unknown score.
    """
    classifier = isinstance(model, SVC)
    scoring = scoring or ("accuracy" if classifier else "r2")
    if scoring not in SCORES:
        raise SettingsError(f"scoring is {scoring!r}; choose one of {sorted(SCORES)}")
    if workers < 1:
        raise SettingsError(f"workers is {workers}; it must be at least 1")
    rows = inputs.as_rows(x)
    inputs.check_memory(len(rows), model.max_memory // workers)
    generator = inputs.generator_of(seed)
    costs, widths = _axis(C, "C").sort().values.to(rows), _axis(gamma, "gamma").to(rows)
    if isinstance(model, SVC):
        classes, signs = inputs.as_binary(y, len(rows))
        targets, tubes = signs.to(rows)[None], torch.zeros(1).to(rows)
    else:
        targets = inputs.as_targets(y, len(rows)).to(rows).reshape(len(rows), -1).T.contiguous()
        tubes = _axis(model.epsilon if epsilon is None else epsilon, "epsilon").to(rows)
    numbers = _folds(folds, targets, classifier, generator)
    masks = training_masks(numbers).to(rows.device)
    every = torch.ones(1, len(rows), dtype=torch.bool, device=rows.device)
    weight = torch.cat([every, masks]).to(rows)
    if isinstance(model, SVC):
        weight = row_weights(targets[0], classes, model.class_weight, weight > 0)
    task = _Task(model, rows, targets, weight, numbers.to(rows.device), costs, tubes, classifier)

    seeds = torch.randint(2**62, (len(widths),), generator=generator).tolist()
    report = _Counter(progress, len(widths) * len(tubes) * len(costs))
    with ThreadPoolExecutor(workers) as pool:
        cells = list(pool.map(lambda w, s: _solve_width(task, w, s, report), widths, seeds))
    held_out, gap, direct = (torch.stack(parts) for parts in zip(*cells, strict=True))
    scores = torch.stack(
        [SCORES[scoring](held_out[..., ~mask], targets[:, ~mask]) for mask in masks], dim=-1
    )
    best, common = _choices(scores.mean(-1), widths, tubes, costs)
    return GridResult(
        costs, widths, tubes, scoring, scores, held_out, gap, direct, numbers, best, common
    )


@dataclass(frozen=True)
class _Task:
    """What the cells of a grid share; `weight` (1 + F, n) is of all rows and of each fold."""

    model: SVC | SVR
    rows: Tensor
    targets: Tensor
    weight: Tensor
    folds: Tensor
    costs: Tensor
    tubes: Tensor
    classifier: bool

    def problems(self, caps: Tensor, tube: Tensor) -> Problems:
        """Cells at costs `caps` (N,): all rows, then each fold, each for all costs and outputs."""
        blocks, outputs = len(self.weight), len(self.targets)
        each = caps.repeat_interleave(outputs).repeat(blocks)
        weight = self.weight.repeat_interleave(len(caps) * outputs, 0)
        if self.classifier:
            return classification(self.targets[0], each, weight)
        targets = self.targets.repeat(blocks * len(caps), 1)
        return regression(targets, each, tube.expand(len(each)).contiguous(), weight)


class _Counter:
    """Counts finished cells of all workers and tells the caller of each."""

    def __init__(self, progress: Progress | None, cells: int) -> None:
        self._progress, self._cells, self._done, self._lock = progress, cells, 0, Lock()

    def add(self, cells: int) -> None:
        with self._lock:
            self._done += cells
            if self._progress is not None:
                self._progress(self._done, self._cells)


def _folds(folds: Any, targets: Tensor, classifier: bool, generator: torch.Generator) -> Tensor:
    """Fold numbers (n,), given or drawn."""
    if not isinstance(folds, int):
        return given_folds(folds, targets.shape[1])
    if classifier:
        return stratified_folds(targets[0], folds, generator)
    return plain_folds(targets.shape[1], folds, generator)


def _solve_width(
    task: _Task, width: Tensor, seed: int, counter: _Counter
) -> tuple[Tensor, Tensor, Tensor]:
    """Held-out values (E, N, K, n), relative gaps and directness (E, N, K) at one gamma."""
    model, generator = task.model, torch.Generator().manual_seed(seed)
    matrix = kernel_matrix(
        make_kernel(model.kernel, float(width), model.degree, model.coef0), task.rows
    )
    outputs, blocks = len(task.targets), len(task.weight)
    shape = len(task.tubes), len(task.costs), outputs
    held_out = task.rows.new_zeros(*shape, len(task.rows))
    gap, direct = task.rows.new_zeros(shape), torch.ones(shape, dtype=torch.bool)
    index = torch.arange(len(task.rows), device=matrix.device)
    # A classifier's systems are small, so all costs go together and share the products with the
    # kernel. A regression goes up the costs, because it often touches no bound from some cost on.
    step = len(task.costs) if task.classifier else 1
    for e, tube in enumerate(task.tubes):
        found: Solutions | None = None
        for c in range(0, len(task.costs), step):
            problems = task.problems(task.costs[c : c + step], tube)
            found = _solve_cells(matrix, problems, step * outputs, found, generator)
            value = (found.product + found.bias[:, None]).reshape(blocks, step, outputs, -1)[1:]
            held_out[e, c : c + step] = value[task.folds, :, :, index].permute(1, 2, 0)
            relative = found.gap / found.objective.abs().clamp_min(1e-12)
            gap[e, c : c + step] = relative.reshape(blocks, step, outputs).amax(0)
            direct[e, c : c + step] = found.direct.reshape(blocks, step, outputs).all(0).cpu()
            counter.add(step)
    return held_out, gap, direct


def _axis(values: Any, name: str) -> Tensor:
    """The distinct positive numbers of one axis of the grid, in the order given."""
    given = [values] if isinstance(values, int | float) else list(values)
    if not given:
        raise SettingsError(f"the grid has no value of {name}; give at least one")
    return torch.tensor([inputs.positive(value, name) for value in given], dtype=torch.float64)


def _solve_cells(
    matrix: Tensor,
    problems: Problems,
    outputs: int,
    before: Solutions | None,
    generator: torch.Generator,
) -> Solutions:
    """Solve cells, all rows first and then the folds from their statuses.

    The first `outputs` problems are on all rows and each further block of as many is a fold.
    `before` holds the same problems at a smaller C: where it touches no bound it still holds.
    """
    todo = torch.arange(len(problems.z), device=matrix.device)
    if before is not None:
        bound = ((before.beta != 0) & (before.status.abs() == 2)).any(1)
        needed = bound.reshape(-1, outputs).any(0).repeat(len(bound) // outputs)
        todo = needed.nonzero().flatten()
    if before is not None and len(todo) == 0:
        return before
    whole, parts = todo[todo < outputs], todo[todo >= outputs]
    full = solve(matrix, problems.take(whole), generator, last=GRID_RIDGE)
    place = torch.zeros(outputs, dtype=torch.long, device=matrix.device)
    place[whole] = torch.arange(len(whole), device=matrix.device)
    folded = problems.take(parts)
    start = _restart(folded, full.take(place[parts % outputs]))
    solved = _join(full, solve(matrix, folded, generator, start, last=GRID_RIDGE))
    if before is None:
        return solved
    merged = {}
    for name in Solutions.__dataclass_fields__:
        tensor = getattr(before, name).clone()
        tensor[todo] = getattr(solved, name)
        merged[name] = tensor
    return replace(before, **merged)


def _restart(problems: Problems, old: Solutions) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients, biases and statuses of `old`, moved into the boxes of `problems`."""
    closed = problems.lower == problems.upper
    status = old.status.masked_fill(closed, 0)
    beta = torch.where(status == 2, problems.upper, old.beta)
    beta = torch.where(status == -2, problems.lower, beta).masked_fill(closed, 0.0)
    return beta, old.bias, status


def _join(first: Solutions, second: Solutions) -> Solutions:
    """Two batches of solutions as one."""
    names = Solutions.__dataclass_fields__
    return Solutions(*(torch.cat([getattr(first, n), getattr(second, n)]) for n in names))


def _choices(
    mean: Tensor, widths: Tensor, tubes: Tensor, costs: Tensor
) -> tuple[tuple[Choice, ...], tuple[Choice, ...]]:
    """The best cell of each output, freely and at the gamma that is best for their mean.

    Of equal scores the first wins: the smallest C, epsilon and gamma in the order given.
    """

    def pick(scores: Tensor, fixed: int | None) -> Choice:
        if fixed is not None:
            scores = scores[fixed : fixed + 1]
        g, e, c = torch.unravel_index(scores.argmax(), scores.shape)
        return Choice(
            C=float(costs[c]),
            gamma=float(widths[int(g) + (fixed or 0)]),
            epsilon=float(tubes[e]),
            score=float(scores[g, e, c]),
        )

    outputs = range(mean.shape[-1])
    shared = int(mean.flatten(1, 2).amax(1).mean(1).argmax())
    return (
        tuple(pick(mean[..., k], None) for k in outputs),
        tuple(pick(mean[..., k], shared) for k in outputs),
    )
