"""Cross-validated choice of C, gamma and epsilon in one batched solve, as exact as libsvm's.

One kernel matrix per gamma serves every fold, every C, every epsilon and every output: a fold
only fixes its held-out coefficients to 0, and their decision values come free as K beta + b.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.ground.processes import in_processes
from cgtorch.svm import inputs
from cgtorch.svm.folds import given_folds, plain_folds, stratified_folds, training_masks
from cgtorch.svm.grid_problems import Task, solve_width
from cgtorch.svm.scores import SCORES
from cgtorch.svm.svc import SVC, row_weights
from cgtorch.svm.svr import SVR, units
from cgtorch.svm.threads import one_thread_each

Progress = Callable[[int, int], None]
"""Called with the number of cells done and of all cells."""

Array: TypeAlias = NDArray[np.float64]


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
    folds: Tensor
    best: tuple[Choice, ...]
    common: tuple[Choice, ...]

    @property
    def mean(self) -> Tensor:
        """Mean score over the folds (G, E, N, K)."""
        return self.scores.mean(-1)


def grid_search(
    model: SVC | SVR,
    x: Any,
    y: Any,
    *,
    C: Sequence[float],
    gamma: Sequence[float],
    epsilon: Sequence[float] | None = None,
    folds: Any = 5,
    seed: int | Generator = 0,
    scoring: str | None = None,
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
        seed: Seed or generator of the folds.
        scoring: A name in `SCORES`; accuracy for `SVC` and r2 for `SVR` if None.
        progress: Called as the cells of a gamma are done with (done, all).

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
    rows = inputs.as_rows(x)
    inputs.check_memory(len(rows), model.max_memory)
    generator = inputs.generator_of(seed)
    costs, widths = _axis(C, "C").sort().values.to(rows), _axis(gamma, "gamma").to(rows)
    if isinstance(model, SVC):
        classes, signs = inputs.as_binary(y, len(rows))
        targets, tubes = signs.to(rows)[None], torch.zeros(1).to(rows)
    else:
        targets = inputs.as_targets(y, len(rows)).to(rows).reshape(len(rows), -1).T.contiguous()
        tubes = _axis(model.epsilon if epsilon is None else epsilon, "epsilon").to(rows)
    numbers = _folds(folds, targets, classifier, generator)
    # Nothing needs these numbers any more; what is drawn after them stays what a seed always gave.
    torch.randint(2**62, (len(widths),), generator=generator)
    masks = training_masks(numbers).to(rows.device)
    weight = masks.to(rows)
    if isinstance(model, SVC):
        weight = row_weights(targets[0], classes, model.class_weight, masks)
    kernel = model.kernel, model.degree, model.coef0
    mean, unit = (0 * targets[:, 0], 0 * targets[:, 0] + 1) if classifier else units(targets)
    scaled = (targets - mean[:, None]) / unit[:, None]
    place = numbers.to(rows.device)
    task = Task(*kernel, rows, scaled, unit, weight, place, costs, tubes, classifier)
    found = _all_widths(task, widths, model.max_memory, progress)
    held_out, gap = (torch.stack(part) for part in zip(*found, strict=True))
    held_out = held_out * unit[:, None] + mean[:, None]
    scores = torch.stack(
        [SCORES[scoring](held_out[..., ~mask], targets[:, ~mask]) for mask in masks], dim=-1
    )
    best, common = _choices(scores.mean(-1), widths, tubes, costs)
    return GridResult(costs, widths, tubes, scoring, scores, held_out, gap, numbers, best, common)


def _all_widths(
    task: Task, widths: Tensor, memory: int, progress: Progress | None
) -> list[tuple[Tensor, ...]]:
    """Values (E, N, K, n) and gaps (E, N, K) at every gamma.

    The largest gammas, which have most support vectors, go first, so that no process ends late.
    How many processes there are does not change the result.
    """
    order = widths.argsort(descending=True)
    each = len(task.tubes) * len(task.costs)
    finished = itertools.count(each, each)

    def work(number: int) -> tuple[Array, Array]:
        cells = solve_width(task, float(widths[order[number]]), threads // processes)
        return cells.held_out.cpu().numpy(), cells.gap.cpu().numpy()

    def done(_: object) -> None:
        if progress is not None:
            progress(next(finished), each * len(widths))

    # The operations are short: torch's own threads would double the time.
    with one_thread_each() as threads:
        processes = min(threads, len(widths), memory // inputs.memory(len(task.rows)))
        if task.rows.device.type != "cpu":
            processes = 1
        found = in_processes(work, len(widths), processes, done)
    tensors = [
        tuple(torch.from_numpy(part).to(task.rows.device) for part in cells) for cells in found
    ]
    return [tensors[place] for place in order.argsort().tolist()]


def _folds(folds: Any, targets: Tensor, classifier: bool, generator: Generator) -> Tensor:
    """Fold numbers (n,), given or drawn."""
    if not isinstance(folds, int):
        return given_folds(folds, targets.shape[1])
    if classifier:
        return stratified_folds(targets[0], folds, generator)
    return plain_folds(targets.shape[1], folds, generator)


def _axis(values: Any, name: str) -> Tensor:
    """The distinct positive numbers of one axis of the grid, in the order given."""
    given = [values] if isinstance(values, int | float) else list(values)
    if not given:
        raise SettingsError(f"the grid has no value of {name}; give at least one")
    return torch.tensor([inputs.positive(value, name) for value in given], dtype=torch.float64)


def _choices(
    mean: Tensor, widths: Tensor, tubes: Tensor, costs: Tensor
) -> tuple[tuple[Choice, ...], tuple[Choice, ...]]:
    """The best cell of each output, freely and at the gamma that is best for their mean.

    Of equal scores the first wins: the smallest C, epsilon and gamma in the order given.
    """

    def pick(scores: Tensor, fixed: int | None) -> Choice:
        if fixed is not None:
            scores = scores[fixed : fixed + 1]
        rest, c = divmod(int(scores.argmax()), scores.shape[2])
        g, e = divmod(rest, scores.shape[1])
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
