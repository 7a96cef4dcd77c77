"""Cross-validated choice of C, gamma and epsilon in one batched solve, as exact as libsvm.

One kernel matrix per gamma serves every fold, C, epsilon and output. A fold only fixes its held-out
coefficients to 0. The problems of each cost start from the solutions for the next smaller one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.native.processes import in_processes, one_thread_each
from cgtorch.svm import inputs
from cgtorch.svm.cross_validation import fold_numbers, score_of, training_masks
from cgtorch.svm.machine import KernelMachine, PerOutput
from cgtorch.svm.problems import Problems, State, Targets, inside, relative_gap
from cgtorch.svm.rbf import Gram
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
    rows = inputs.training_rows(x)
    generator = inputs.generator_of(seed)
    costs, widths = tuple(sorted(_axis(C, "C"))), _axis(gamma, "gamma")
    targets = model.targets(y, rows)
    given = model.epsilon if epsilon is None else epsilon
    tubes = (0.0,) if targets.classes is not None else _axis(given, "epsilon")
    numbers = fold_numbers(folds, targets, generator)
    # These numbers are unused, but drawing them keeps all later draws of a seed the same.
    torch.randint(2**62, (len(widths),), generator=generator)
    masks = training_masks(numbers).to(rows.device)
    # The largest gammas, which have most support vectors, go first, so that no process ends late.
    order = sorted(range(len(widths)), key=lambda place: -widths[place])

    def work(number: int) -> tuple[Tensor, Tensor]:
        gram = Gram(rows, widths[order[number]], threads // processes)
        return _solve_width(model, gram, targets, masks, costs, tubes)

    # The operations are short: torch's own threads would double the time.
    with one_thread_each() as threads:
        most = inputs.MAX_MEMORY // inputs.memory(len(rows))
        processes = min(threads, len(widths), most) if rows.is_cpu else 1
        found = in_processes(work, len(widths), processes)
    in_order = [found[order.index(place)] for place in range(len(widths))]
    values, gap = (torch.stack(part) for part in zip(*in_order, strict=True))
    held_out = targets.restored(values)
    scores = torch.stack([score(held_out[..., ~m], targets.y[:, ~m]) for m in masks], dim=-1)
    best = _best(costs, widths, tubes, scores.mean(-1))
    axes = [torch.tensor(axis, dtype=torch.float64).to(rows) for axis in (costs, widths, tubes)]
    return GridResult(axes[0], axes[1], axes[2], scores, held_out, gap, numbers, best)


def _solve_width(
    model: KernelMachine,
    gram: Gram,
    targets: Targets,
    masks: Tensor,
    costs: Sequence[float],
    tubes: Sequence[float],
) -> tuple[Tensor, Tensor]:
    """Held-out values (E, N, K, n) in the solver's units, and largest relative gaps (E, N, K).

    The masks (F, n) are those of rows on which each fold trains.
    """
    by_fold = len(targets.y), len(masks)
    place = (~masks).long().argmax(0).expand(by_fold[0], 1, -1)
    values, gaps = [], []
    for tube in tubes:
        before: tuple[Problems, State] | None = None
        for cost in costs:
            problems = model.problems(targets, masks, cost, tube)
            start = scaled_start(*before, problems) if before else None
            found = solve(gram, problems, start, ROUGH)
            value = (found.product + found.bias[:, None]).unflatten(0, by_fold)
            values.append(value.gather(1, place).squeeze(1))
            gaps.append(relative_gap(problems, found).unflatten(0, by_fold).amax(1))
            before = problems, found
    shape = len(tubes), len(costs)
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


def _best(
    costs: Sequence[float], widths: Sequence[float], tubes: Sequence[float], mean: Tensor
) -> tuple[Choice, ...]:
    """The best grid point of each output by mean scores (G, E, N, K)."""
    choices = []
    for scores in mean.unbind(-1):
        # torch.unravel_index imports sympy, which takes a second.
        rest, n = divmod(int(scores.argmax()), len(costs))
        g, e = divmod(rest, len(tubes))
        choices.append(Choice(costs[n], widths[g], tubes[e], float(scores[g, e, n])))
    return tuple(choices)
