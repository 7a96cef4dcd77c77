"""Fitting Γ: hyper-parameters from cross-validation, then a fit to all transitions.

An output is used only if it beats a model without a machine in cross-validation by more than the
standard error over rows, so that noise is not fitted.
"""

from typing import Any, TypeVar

import torch

from cgtorch.domains.reports import TransitionReport
from cgtorch.domains.transition import Grid, HeldOut, TransitionModel
from cgtorch.svm import SVR, Choice, doubling_sizes, grid_search, inputs, learning_values

SCORE = "neg_mean_absolute_error"
_CURVE_ROWS = 1000
_FEWEST = 10  # rows that tell the machine something, below which it is shown all

Gamma = TypeVar("Gamma", bound=TransitionModel)


def fit_transition_model(
    model: Gamma,
    percept: Any,
    control: Any,
    next_percept: Any,
    *,
    seed: int | torch.Generator = 0,
    grid: Grid | None = None,
    dtype: torch.dtype = torch.float32,
) -> tuple[Gamma, TransitionReport]:
    """Choose the hyper-parameters by cross-validation and fit Γ to all transitions, in place.

    All outputs share γ and ε, so one kernel evaluation serves all; each output has its own C.

    Args:
        model: The transition model.
        percept: (n, D) percepts.
        control: (n, U) controls.
        next_percept: (n, D) next percepts.
        seed: A seed, or a generator.
        grid: The grid; the model's own by default.
        dtype: The type of the model's buffers.

    Raises:
        DataError: Wrong shapes, NaN, too few rows or too many.
        SettingsError: A grid that cannot be used.
    """
    p, u, q = rows = model.checked(percept, control, next_percept)
    generator, grid = inputs.generator_of(seed), grid or model.grid
    model.to(p.device).standardise(p, u, q, dtype)
    x, y, tells = model.learnable(p, u, q)
    if int(tells.sum()) < _FEWEST:
        tells = torch.ones_like(tells)  # the comparison below shows that nothing can be learnt
    x, y = x[tells], y[tells]
    one = slice(None if bool(y.any()) else 1)  # without rows, one cell is enough
    some = torch.randperm(len(x), generator=generator)[: grid.rows].to(x.device)
    found = grid_search(
        SVR(), x[some], y[some], C=grid.C[one], gamma=[g / x.shape[1] for g in grid.gamma[one]],
        epsilon=grid.epsilon[one], seed=generator, scoring=SCORE,
    )  # fmt: skip
    best, place = found.mean.max(2)  # over C, by gamma, epsilon and output
    g, e = divmod(int(best.mean(-1).argmax()), best.shape[1])
    cell = g, e, place[g, e], torch.arange(y.shape[1])
    costs, width, tube = found.C[cell[2]].tolist(), float(found.gamma[g]), float(found.epsilon[e])
    machine, value = SVR(costs, gamma=width, epsilon=tube), found.held_out[cell].T
    if (every := model.held_out(machine, x, y, generator)) is not None:
        some, value = torch.arange(len(x), device=x.device), every
    gain = y[some].abs() - (value - y[some]).abs()
    learnt = gain.mean(0) > gain.std(0) / len(gain) ** 0.5
    few = some[:_CURVE_ROWS]
    curve = learning_values(machine, x[few], y[few], sizes=doubling_sizes(len(few)), seed=generator)
    model.machine = machine.fit(x, y)
    model.measure_reach(x)
    error, baseline = model.settle(rows, HeldOut(tells, value, y[some], learnt))
    scores = zip(costs, best[g, e].tolist(), learnt.tolist(), strict=True)
    fields = model.fields(p.shape[1])
    report = TransitionReport(
        rows=len(p),
        informative=len(x),
        coordinates=tuple(field.name for field in fields),
        units=tuple(field.unit for field in fields),
        error=tuple(error.tolist()),
        baseline_error=tuple(baseline.tolist()),
        choice=tuple(Choice(c, width, tube, s) if learnt else None for c, s, learnt in scores),
        gap=tuple(machine.gap.tolist()),
        centres=len(machine.centres),
        grid_cost=tuple(found.C.tolist()),
        grid_gamma=tuple(found.gamma.tolist()),
        grid_epsilon=tuple(found.epsilon.tolist()),
        grid_scores=found.mean.tolist(),
        learning_curve=curve.scored(SCORE),
    )
    return model.to(dtype), report
