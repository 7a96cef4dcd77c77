"""Fitting Γ: the table's sides by least squares, to which side it is turned by an SVR.

What does not beat "nothing is known" in cross-validation, by more than the standard error over
rows, is not used, so that noise is not chased.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.errors import DataError
from cgtorch.models import geometry, inputs
from cgtorch.models.grid_search import Choice, Progress, grid_search
from cgtorch.models.learning_curve import LearningCurve, doubling_sizes, learning_curve
from cgtorch.models.machine import KernelMachine
from cgtorch.models.svr import SVR
from cgtorch.models.transition import TransitionModel

C_GRID = (1.0, 4.0)
GAMMA_GRID = (0.5, 1.0, 2.0)
EPSILON_GRID = (0.1,)
GRID_ROWS = 800
DECISIVE = 0.03
"""Metres by which the boxes of the two yaws have to differ for a transition to tell them apart:
three times the noise of a transition."""
PARTS = ("turn",)
_SCORE = "neg_mean_absolute_error"
_CURVE_ROWS = 1000
_QUIET_CENTRES = 256


@dataclass(frozen=True)
class TransitionReport:
    """What the fit of a transition model found.

    Attributes:
        rows: Transitions it learnt from.
        coordinates: Names of the D percept coordinates.
        error: Cross-validated mean absolute error of each coordinate, m.
        rigid_error: The same of a model that knows nothing of the table's shape, m.
        sides: Sides of the table (2,), m.
        decisive: Transitions that tell to which side the table was turned.
        parts: Name of the part that is learnt.
        choice: Its hyper-parameters (C, gamma, epsilon, score), None if it is not used.
        gap: Duality gap of its dual problem, 0 if it is not used.
        centres: Number of centres.
        grid_cost: Costs tried.
        grid_gamma: Kernel widths tried.
        grid_epsilon: Tube widths tried.
        grid_scores: Mean negative absolute error by gamma, epsilon, C and part.
        finished_by_smo: Cells of the grid that the active set left to SMO.
        learning_curve: The same score by the number of decisive transitions learnt from.
    """

    rows: int
    coordinates: tuple[str, ...]
    error: tuple[float, ...]
    rigid_error: tuple[float, ...]
    sides: tuple[float, ...]
    decisive: int
    parts: tuple[str, ...]
    choice: tuple[Choice | None, ...]
    gap: tuple[float, ...]
    centres: int
    grid_cost: tuple[float, ...]
    grid_gamma: tuple[float, ...]
    grid_epsilon: tuple[float, ...]
    grid_scores: list[Any]
    finished_by_smo: int
    learning_curve: LearningCurve | None = None


def transition_rows(
    percept: Any, motion: Any, next_percept: Any, max_memory: int = inputs.MAX_MEMORY
) -> tuple[Tensor, Tensor, Tensor]:
    """Percepts (n, D), motions (n, 3) and next percepts (n, D) in float64, checked.

    Raises:
        DataError: Wrong shapes, NaN, or more rows than `max_memory` allows.
    """
    p, u = inputs.as_rows(percept, "percept"), inputs.as_rows(motion, "motion")
    q = inputs.as_rows(next_percept, "next_percept")
    geometry.check_percept(p, u)
    if not len(p) == len(u) == len(q) or q.shape[1] != p.shape[1]:
        raise DataError(
            f"percept, motion and next percept have {len(p)}, {len(u)} and {len(q)} rows of "
            f"{p.shape[1]}, {u.shape[1]} and {q.shape[1]}; pass equally many of D, 3 and D"
        )
    inputs.check_memory(len(p), max_memory)
    return p, u, q


def which_yaw(
    model: TransitionModel, percept: Tensor, motion: Tensor, next_percept: Tensor
) -> tuple[Tensor, Tensor]:
    """What transitions (n, ...) tell the machine: targets (n,), and (n,) bool which are decisive.

    The target is where the next extents lie between those of the second yaw, -1, and of the
    first, 1. Where the percept tells the yaw, it is 0 and all transitions are worth as much.
    """
    yaws, sides = geometry.tables_seen(percept, model.sides.to(percept))
    first, second = geometry.boxes_after(yaws, motion, sides).unbind(-2)
    half = (first - second) / 2
    size = half.norm(dim=-1)
    off = geometry.to_parts(next_percept)[..., 2:4] - (first + second) / 2
    target = ((off * half).sum(-1) / size.square().clamp_min(1e-12)).clamp(-1, 1)
    return target, (size > DECISIVE / 2) | (yaws[..., 0] == yaws[..., 1])


def fit_transition_model(
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
    progress: Progress | None = None,
    max_memory: int = inputs.MAX_MEMORY,
    dtype: torch.dtype = torch.float32,
) -> tuple[TransitionModel, TransitionReport]:
    """Choose the hyper-parameters by cross-validation and fit Γ on all transitions.

    Args:
        percept: Percepts before (n, D), m.
        motion: Motions (n, 3), m and rad.
        next_percept: Percepts after (n, D), m.
        seed: Seed or generator of folds, subset and solver.
        folds: Number of folds.
        C: Costs to try.
        gamma: Kernel widths to try, on standardised features.
        epsilon: Tube widths to try; the targets are -1 to 1.
        grid_rows: Random decisive rows that the grid is scored on, None for all.
        progress: Called with (cells done, all cells).
        max_memory: Bytes that kernel matrices may take.
        dtype: Type of the returned model's buffers.

    Returns:
        The model and the report.

    Raises:
        DataError: Wrong shapes, NaN, too few rows or too many.
        SettingsError: A grid that cannot be used.
    """
    p, u, q = transition_rows(percept, motion, next_percept, max_memory)
    generator = inputs.generator_of(seed)
    model = _geometry_of(p, u, q).to(dtype).double()  # which learning on will see like this
    target, tells = which_yaw(model, p, u, q)
    if int(tells.sum()) < 2 * folds:
        tells = torch.ones_like(tells)  # nothing can be learnt, which the comparison will show
    if not bool(target.any()):  # as where the yaw is seen: one cell shows as much as many
        C, gamma, epsilon = C[:1], gamma[:1], epsilon[:1]
    rows, wanted = model.features(p)[tells], target[tells]
    some = torch.randperm(len(rows), generator=generator)[: grid_rows or len(rows)].to(p.device)
    plain = SVR(max_memory=max_memory)
    grid = grid_search(
        plain, rows[some], wanted[some], C=C, gamma=gamma, epsilon=epsilon, folds=folds,
        seed=generator, scoring=_SCORE, progress=progress,
    )  # fmt: skip
    best = grid.best[0]
    machine = SVR(best.C, gamma=best.gamma, epsilon=best.epsilon, max_memory=max_memory)
    value = grid_search(
        machine, rows, wanted, C=[best.C], gamma=[best.gamma], folds=folds, seed=generator
    ).held_out[0, 0, 0, 0]
    learnt = _better((value.clamp(-1, 1) - wanted).abs(), wanted.abs())
    sizes = doubling_sizes(len(rows[:_CURVE_ROWS]), folds)
    curve = learning_curve(
        machine, rows[:_CURVE_ROWS], wanted[:_CURVE_ROWS],
        sizes=sizes, folds=folds, seed=generator, scoring=_SCORE,
    )  # fmt: skip
    machine.seed = generator
    model.machine = machine.fit(rows, wanted[:, None])
    if not learnt:
        _silence(machine, rows)
    model.reach = rim(machine, rows)
    held_out = model.machine.values(model.features(p))[:, 0]
    held_out[tells] = value * learnt  # the others were not learnt from
    error, rigid_error = _settle(model, p, u, q, held_out)
    report = TransitionReport(
        rows=len(p),
        coordinates=geometry.coordinates(p),
        error=tuple(error.tolist()),
        rigid_error=tuple(rigid_error.tolist()),
        sides=tuple(model.sides.tolist()),
        decisive=len(rows),
        parts=PARTS,
        choice=(best if learnt else None,),
        gap=tuple(machine.gap.tolist()),
        centres=len(machine.centres),
        grid_cost=tuple(grid.C.tolist()),
        grid_gamma=tuple(grid.gamma.tolist()),
        grid_epsilon=tuple(grid.epsilon.tolist()),
        grid_scores=grid.mean.tolist(),
        finished_by_smo=int((~grid.direct).sum()),
        learning_curve=curve,
    )
    return model.to(dtype), report


def _geometry_of(p: Tensor, u: Tensor, q: Tensor) -> TransitionModel:
    """A model that knows the table's sides and the scale of the features, but not the turn."""
    model = TransitionModel().to(p.device)
    before, after = geometry.to_parts(p), geometry.to_parts(q)
    model.sides = geometry.table_sides(torch.cat([before, after])[:, 2:4])
    yaws, sides = geometry.tables_seen(p, model.sides)
    places = geometry.places_on_table(before, yaws)
    model.mean = places.mean(0)
    # One scale for all: they are lengths, seen with the same noise.
    spread = places.var(0, correction=0).mean().sqrt()
    model.scale = torch.where(spread > 1e-9, spread, 1.0).expand(geometry.FEATURES).clone()
    most = geometry.extremes(before, u, yaws, sides).amax(0)
    model.most = most.clamp_min(1e-3)
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
    model: TransitionModel, p: Tensor, u: Tensor, q: Tensor, held_out: Tensor
) -> tuple[Tensor, Tensor]:
    """Trust turning the table only if that beats turning its box loosely; errors of both (D,).

    The first is the error of the model as it is settled, the second without that trust.
    """
    errors = []
    for trust in (1.0, 0.0):
        model.trust = torch.tensor(trust).to(p)
        errors.append((model.following(p, u, held_out) - q).abs())
    turned, loose = errors
    better = _better(turned[:, :4].mean(1), loose[:, :4].mean(1))
    model.trust = torch.tensor(float(better)).to(p)
    return (turned if better else loose).mean(0), loose.mean(0)


def rim(machine: KernelMachine, features: Tensor) -> Tensor:
    """Squared distance () that 95 % of training rows have a centre other than themselves within."""
    some = features[:: max(1, len(features) // 1024)]
    distance = torch.cdist(some.double(), machine.centres.double()).square()
    distance = torch.where(distance < 1e-16, torch.inf, distance)
    nearest = distance.amin(1)
    nearest = nearest[torch.isfinite(nearest)]
    if len(nearest) == 0:
        return torch.ones_like(machine.gamma_value)
    return nearest.quantile(0.95).clamp_min(1e-12)
