"""Fitting Γ of any domain: hyper-parameters by cross-validation, then all transitions.

What does not beat "nothing is known" in cross-validation, by more than the standard error over
rows, is not used, so that noise is not chased.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.learned_model import mean_and_spread
from cgtorch.domains.reports import TransitionReport
from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.svm import SVR, Choice, doubling_sizes, grid_search, inputs, learning_curve

C_GRID = (1.0, 10.0, 100.0)
GAMMA_GRID = (0.3, 1.0, 3.0)
"""Kernel widths for one feature; divided by the number of features."""
EPSILON_GRID = (0.02, 0.1)
GRID_ROWS = 600
SCORE = "neg_mean_absolute_error"
_CURVE_ROWS = 1000


def fit_transition_model(
    model: KernelTransitionModel,
    percept: Any,
    control: Any,
    next_percept: Any,
    *,
    seed: int | torch.Generator = 0,
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
        seed: Seed or generator of folds and subset.
        C: Costs to try, on standardised targets.
        gamma: Kernel widths to try, on standardised features, for one feature.
        epsilon: Tube widths to try, on standardised targets.
        dtype: Type of the returned model's buffers.

    Raises:
        DataError: Wrong shapes, NaN, too few rows or too many.
    """
    rows = model.checked(percept, control, next_percept)
    generator = inputs.generator_of(seed)
    _standardise(model, *rows)
    features, target, _ = model.learnable(*rows)
    some = torch.randperm(len(features), generator=generator)[:GRID_ROWS]
    widths = [width / features.shape[1] for width in gamma]
    grid = grid_search(
        SVR(), features[some], target[some], C=C, gamma=widths, epsilon=epsilon, seed=generator,
        scoring=SCORE,
    )  # fmt: skip
    best, place = grid.mean.max(2)  # over C, by gamma, epsilon and output
    g, e = divmod(int(best.mean(-1).argmax()), best.shape[1])
    cell = g, e, place[g, e], torch.arange(target.shape[1])
    costs, width, tube = grid.C[cell[2]].tolist(), float(grid.gamma[g]), float(grid.epsilon[e])
    error, baseline = (grid.held_out[cell].T - target[some]).abs(), target[some].abs()
    gain = baseline - error
    model.learnt = (gain.mean(0) > gain.std(0) / len(gain) ** 0.5).to(features)
    machine, few = SVR(costs, gamma=width, epsilon=tube), some[:_CURVE_ROWS]
    curve = learning_curve(
        machine, features[few], target[few], sizes=doubling_sizes(len(few)), seed=generator,
        scoring=SCORE,
    )  # fmt: skip
    model.machine = machine.fit(features, target)
    model.measure_reach(features)
    used = torch.where(model.learnt > 0, error.mean(0), baseline.mean(0)) * model.spread
    scores = zip(costs, best[g, e].tolist(), model.learnt.tolist(), strict=True)
    report = TransitionReport(
        rows=len(features),
        informative=len(features),
        coordinates=tuple(field.name for field in model.percept_fields),
        units=tuple(field.unit for field in model.percept_fields),
        error=tuple(used.tolist()),
        baseline_error=tuple((baseline.mean(0) * model.spread).tolist()),
        choice=tuple(Choice(c, width, tube, s) if learnt else None for c, s, learnt in scores),
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
    model.mean, model.scale = mean_and_spread(model.raw_features(p, u))
    model.shift, model.spread = mean_and_spread(model.difference(p, q))
    model.most = model.extremes(p, u).amax(0).clamp_min(1e-3)
