"""Fitting Γ of any domain: hyper-parameters by cross-validation, then all transitions.

What does not beat "nothing is known" in cross-validation, by more than the standard error over
rows, is not used, so that noise is not chased.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.reports import TransitionReport
from cgtorch.domains.transition import KernelTransitionModel, rim
from cgtorch.ground.errors import DataError
from cgtorch.svm import SVR, GridResult, doubling_sizes, grid_search, inputs, learning_curve

C_GRID = (1.0, 10.0, 100.0)
GAMMA_GRID = (0.3, 1.0, 3.0)
"""Kernel widths for one feature; divided by the number of features."""
EPSILON_GRID = (0.02, 0.1)
GRID_ROWS = 600
SCORE = "neg_mean_absolute_error"
_CURVE_ROWS = 1000


def transition_rows(
    percept: Any, control: Any, next_percept: Any, max_memory: int = inputs.MAX_MEMORY
) -> tuple[Tensor, Tensor, Tensor]:
    """Percepts (n, D), controls (n, U) and next percepts (n, D) in float64, checked.

    Raises:
        DataError: Wrong shapes, NaN, or more rows than `max_memory` allows.
    """
    p, u = inputs.as_rows(percept, "percept"), inputs.as_rows(control, "control")
    q = inputs.as_rows(next_percept, "next_percept")
    if not len(p) == len(u) == len(q) or q.shape[1] != p.shape[1]:
        raise DataError(
            f"percept, control and next percept have {len(p)}, {len(u)} and {len(q)} rows of "
            f"{p.shape[1]}, {u.shape[1]} and {q.shape[1]}; pass equally many of D, U and D"
        )
    inputs.check_memory(len(p), max_memory)
    return p, u, q


def fit_transition_model(
    model: KernelTransitionModel,
    percept: Any,
    control: Any,
    next_percept: Any,
    *,
    seed: int | torch.Generator = 0,
    folds: int = 5,
    C: Sequence[float] = C_GRID,
    gamma: Sequence[float] = GAMMA_GRID,
    epsilon: Sequence[float] = EPSILON_GRID,
    dtype: torch.dtype = torch.float32,
) -> tuple[KernelTransitionModel, TransitionReport]:
    """Choose the hyper-parameters by cross-validation and fit Γ on all transitions, in place.

    All outputs share γ and ε, so that one kernel evaluation answers them; each has its own C.

    Args:
        model: An unfitted Γ, which knows the fields of percepts and controls.
        percept: Percepts before (n, D).
        control: Controls (n, U).
        next_percept: Percepts after (n, D).
        seed: Seed or generator of folds, subset and solver.
        folds: Number of folds.
        C: Costs to try, on standardised targets.
        gamma: Kernel widths to try, on standardised features, for one feature.
        epsilon: Tube widths to try, on standardised targets.
        dtype: Type of the returned model's buffers.

    Returns:
        The model and the report.

    Raises:
        DataError: Wrong shapes, NaN, too few rows or too many.
    """
    p, u, q = transition_rows(percept, control, next_percept)
    generator = inputs.generator_of(seed)
    _standardise(model, p, u, q)
    features, (target, _) = model.features(p, u), model.targets(p, u, q)
    some = torch.randperm(len(features), generator=generator)[:GRID_ROWS]
    widths = [width / features.shape[1] for width in gamma]
    grid = grid_search(
        SVR(), features[some], target[some], C=C, gamma=widths, epsilon=epsilon, folds=folds,
        seed=generator, scoring=SCORE,
    )  # fmt: skip
    place = _shared_cell(grid)
    costs = [float(grid.C[c]) for c in place[2]]
    width, tube = float(grid.gamma[place[0]]), float(grid.epsilon[place[1]])
    held_out = grid.held_out[place[0], place[1], place[2], torch.arange(len(costs))].T
    error, baseline = (held_out - target[some]).abs(), target[some].abs()
    gain = baseline - error
    model.learnt = (gain.mean(0) > gain.std(0) / len(gain) ** 0.5).to(p)
    machine = SVR(costs, gamma=width, epsilon=tube)
    few = some[:_CURVE_ROWS]
    curve = learning_curve(
        machine, features[few], target[few], sizes=doubling_sizes(len(few), folds), folds=folds,
        seed=generator, scoring=SCORE,
    )  # fmt: skip
    model.machine = machine.fit(features, target)
    model.reach = rim(machine, features)
    used = torch.where(model.learnt > 0, error.mean(0), baseline.mean(0)) * model.spread
    score = grid.mean[place[0], place[1], place[2], torch.arange(len(costs))]
    report = TransitionReport(
        rows=len(p),
        informative=len(p),
        coordinates=tuple(field.name for field in model.percept_fields),
        units=tuple(field.unit for field in model.percept_fields),
        error=tuple(used.tolist()),
        baseline_error=tuple((baseline.mean(0) * model.spread).tolist()),
        choice=tuple(
            grid.best[i].__class__(costs[i], width, tube, float(score[i])) if learnt else None
            for i, learnt in enumerate(model.learnt.tolist())
        ),
        gap=tuple(machine.gap.tolist()),
        centres=len(machine.centres),
        grid_cost=tuple(grid.C.tolist()),
        grid_gamma=tuple(grid.gamma.tolist()),
        grid_epsilon=tuple(grid.epsilon.tolist()),
        grid_scores=grid.mean.tolist(),
        learning_curve=curve,
    )
    return model.to(dtype), report


def _standardise(model: KernelTransitionModel, p: Tensor, u: Tensor, q: Tensor) -> None:
    """Let the model know the scales of features and changes, in place."""
    change, raw = model.difference(p, q), model.raw_features(p, u)
    model.mean, model.scale = raw.mean(0), _spread(raw)
    model.shift, model.spread = change.mean(0), _spread(change)
    model.most = model.extremes(p, u).amax(0).clamp_min(1e-3)


def _spread(values: Tensor) -> Tensor:
    """Standard deviations (k,) of values (n, k), 1 where there is none."""
    spread = values.std(0, correction=0)
    return torch.where(spread > 1e-9 * (1 + values.abs().amax(0)), spread, 1.0)


def _shared_cell(grid: GridResult) -> tuple[int, int, Tensor]:
    """Where γ and ε have the best mean score over the outputs, and each output's C (K,) there."""
    best, costs = grid.mean.max(2)  # (G, E, K)
    flat = int(best.mean(-1).argmax())
    g, e = divmod(flat, best.shape[1])
    return g, e, costs[g, e]
