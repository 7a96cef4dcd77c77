"""Fitting Γ: the table's sides by least squares, to which side it is turned by an SVR.

What does not beat "nothing is known" in cross-validation, by more than the standard error over
rows, is not used, so that noise is not chased.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.reports import TransitionReport
from cgtorch.domains.transition import transition_rows
from cgtorch.domains.transition_fit import SCORE
from cgtorch.svm import SVR, doubling_sizes, grid_search, inputs, learning_curve
from cgtorch.tabletop.models import geometry
from cgtorch.tabletop.models.transition import TableTransitionModel
from cgtorch.tabletop.world.percepts import parts_of, percept_fields

C_GRID = (1.0, 4.0)
GAMMA_GRID = (0.5, 1.0, 2.0)
EPSILON_GRID = (0.1,)
GRID_ROWS = 800
_CURVE_ROWS = 1000
_QUIET_CENTRES = 256


def fit_table_transition_model(
    percept: Any,
    motion: Any,
    next_percept: Any,
    *,
    seed: int | torch.Generator = 0,
    folds: int = 5,
    C: Sequence[float] = C_GRID,
    gamma: Sequence[float] = GAMMA_GRID,
    epsilon: Sequence[float] = EPSILON_GRID,
    grid_rows: int | None = GRID_ROWS,
    dtype: torch.dtype = torch.float32,
) -> tuple[TableTransitionModel, TransitionReport]:
    """Choose the hyper-parameters by cross-validation and fit Γ on all transitions.

    Arguments are those of `fit_transition_model`, but that targets are -1 to 1 and that `grid_rows`
    says on how many random decisive rows the grid is scored, None for all.

    Raises:
        DataError: Wrong shapes, NaN, too few rows or too many.
        SettingsError: A grid that cannot be used.
    """
    p, u, q = transition_rows(percept, motion, next_percept)
    geometry.check_shapes(p, u)
    generator = inputs.generator_of(seed)
    model = _geometry_of(p, u, q).to(dtype).double()  # which learning on will see like this
    target, tells = model.targets(p, u, q)
    target = target[:, 0]
    if int(tells.sum()) < 2 * folds:
        tells = torch.ones_like(tells)  # nothing can be learnt, which the comparison will show
    if not bool(target.any()):  # as where the yaw is seen: one cell shows as much as many
        C, gamma, epsilon = C[:1], gamma[:1], epsilon[:1]
    rows, wanted = model.features(p, u)[tells], target[tells]
    some = torch.randperm(len(rows), generator=generator)[: grid_rows or len(rows)].to(p.device)
    grid = grid_search(
        SVR(), rows[some], wanted[some], C=C, gamma=gamma, epsilon=epsilon, folds=folds,
        seed=generator, scoring=SCORE,
    )  # fmt: skip
    best = grid.best[0]
    machine = SVR(best.C, gamma=best.gamma, epsilon=best.epsilon)
    value = grid_search(
        machine, rows, wanted, C=[best.C], gamma=[best.gamma], folds=folds, seed=generator
    ).held_out[0, 0, 0, 0]
    learnt = _better((value.clamp(-1, 1) - wanted).abs(), wanted.abs())
    few = rows[:_CURVE_ROWS]
    curve = learning_curve(
        machine, few, wanted[: len(few)], sizes=doubling_sizes(len(few), folds), folds=folds,
        seed=generator, scoring=SCORE,
    )  # fmt: skip
    model.machine = machine.fit(rows, wanted[:, None])
    if not learnt:
        _silence(machine, rows)
    model.measure_reach(rows)
    held_out = model.machine.values(model.features(p, u))[:, 0]
    held_out[tells] = value * learnt  # the others were not learnt from
    error, rigid_error = _settle(model, p, u, q, held_out)
    report = TransitionReport(
        rows=len(p),
        informative=len(rows),
        coordinates=tuple(field.name for field in percept_fields(p.shape[1])),
        units=("m",) * p.shape[1],
        error=tuple(error.tolist()),
        baseline_error=tuple(rigid_error.tolist()),
        choice=(best if learnt else None,),
        gap=tuple(machine.gap.tolist()),
        centres=len(machine.centres),
        grid_cost=tuple(grid.C.tolist()),
        grid_gamma=tuple(grid.gamma.tolist()),
        grid_epsilon=tuple(grid.epsilon.tolist()),
        grid_scores=grid.mean.tolist(),
        learning_curve=curve,
    )
    return model.to(dtype), report


def _geometry_of(p: Tensor, u: Tensor, q: Tensor) -> TableTransitionModel:
    """A model that knows the table's sides and the scale of the features, but not the turn."""
    model = TableTransitionModel().to(p.device)
    model.sides = geometry.table_sides(geometry.to_parts(torch.cat([p, q]))[:, geometry.EXTENTS])
    scene = geometry.scene_of(p, model.sides)
    places = geometry.places_on_table(scene)
    model.mean = places.mean(0)
    # One scale for all: they are lengths, seen with the same noise.
    spread = places.var(0, correction=0).mean().sqrt()
    model.scale = torch.where(spread > 1e-9, spread, 1.0).expand(places.shape[1]).clone()
    model.most = geometry.extremes(scene, u).amax(0).clamp_min(1e-3)
    return model


def _better(error: Tensor, baseline: Tensor) -> bool:
    """Whether errors (n,) are below those of the baseline by more than the standard error."""
    gain = baseline - error
    return bool(gain.mean() > gain.std() / len(gain) ** 0.5)


def _silence(machine: SVR, rows: Tensor) -> None:
    """Let the machine say 0 everywhere; a few centres stay, to tell novelty from."""
    some = torch.arange(min(len(rows), _QUIET_CENTRES), device=rows.device)
    machine.centres, machine.support = rows[some].clone(), some
    machine.weights = rows.new_zeros(len(some), 1)
    machine.bias, machine.gap, machine.cost = (rows.new_zeros(1) for _ in range(3))


def _settle(
    model: TableTransitionModel, p: Tensor, u: Tensor, q: Tensor, held_out: Tensor
) -> tuple[Tensor, Tensor]:
    """Trust turning the table only if that beats turning its box loosely; errors of both (D,).

    The first is the error of the model as it is settled, the second without that trust.
    """
    errors = []
    for trust in (1.0, 0.0):
        model.trust = torch.tensor(trust).to(p)
        errors.append((model.next_percept(p, u, held_out[:, None]) - q).abs())
    turned, loose = errors
    better = _better(parts_of(turned).box.mean(1), parts_of(loose).box.mean(1))
    model.trust = torch.tensor(float(better)).to(p)
    return (turned if better else loose).mean(0), loose.mean(0)
