"""Γ, the transition model: the next percept from a percept and a motion.

The rigid part of the answer is known and computed (`cgtorch.models.geometry`); support vector
regression learns what is left. A part whose regression does not beat "nothing is left" in
cross-validation, by more than the standard error, keeps a residual of zero, so that noise is not
chased.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from cgtorch.errors import DataError
from cgtorch.models import geometry, inputs
from cgtorch.models.folds import plain_folds
from cgtorch.models.grid_search import Choice, GridResult, Progress, grid_search
from cgtorch.models.machine import KernelMachine
from cgtorch.models.svr import SVR

C_GRID = (1.0, 4.0, 16.0, 64.0)
GAMMA_GRID = (0.1, 0.2, 0.4, 0.8)
EPSILON_GRID = (0.05,)
GRID_ROWS = 700
_QUIET_CENTRES = 256


@dataclass(frozen=True)
class TransitionReport:
    """What the fit of a transition model found.

    Attributes:
        rows: Transitions it learnt from.
        coordinates: Names of the 7 percept coordinates.
        error: Cross-validated mean absolute error of each coordinate, m.
        rigid_error: The same for the rigid motion alone, m.
        parts: Names of the 7 parts that residuals are learnt for.
        choice: Hyper-parameters (C, gamma, epsilon, score) of each part, None for residual zero.
        gap: Duality gap of each part's dual problem, 0 for parts that are not learnt.
        centres: Number of centres.
        grid_cost: Costs tried.
        grid_gamma: Kernel widths tried.
        grid_epsilon: Tube widths tried.
        grid_scores: Mean negative absolute error by gamma, epsilon, C and part, standardised.
        finished_by_smo: Cells of the grid that the active set left to SMO.
    """

    rows: int
    coordinates: tuple[str, ...]
    error: tuple[float, ...]
    rigid_error: tuple[float, ...]
    parts: tuple[str, ...]
    choice: tuple[Choice | None, ...]
    gap: tuple[float, ...]
    centres: int
    grid_cost: tuple[float, ...]
    grid_gamma: tuple[float, ...]
    grid_epsilon: tuple[float, ...]
    grid_scores: list[Any]
    finished_by_smo: int


class TransitionModel(nn.Module):
    """Γ: (percept (..., 7), motion (..., 3)) -> next percept (..., 7), m and rad.

    Differentiable in both. Buffers: the features' `mean` and `scale` (6,), the residuals'
    `residual_scale` (7,) and `reach` (), the squared feature distance that counts as half novel.
    """

    mean: Tensor
    scale: Tensor
    residual_scale: Tensor
    reach: Tensor
    machine: SVR

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(geometry.FEATURES, dtype=torch.float64))
        self.register_buffer("scale", torch.ones(geometry.FEATURES, dtype=torch.float64))
        self.register_buffer("residual_scale", torch.ones(7, dtype=torch.float64))
        self.register_buffer("reach", torch.ones((), dtype=torch.float64))
        self.machine = SVR()

    def forward(self, percept: Tensor, motion: Tensor) -> Tensor:
        """Next percept (..., 7).

        Raises:
            DataError: Wrong shapes.
            ModelError: Not fitted.
        """
        return self._both(percept, motion)[0]

    def novelty(self, percept: Tensor, motion: Tensor) -> Tensor:
        """How far (...) from the training data: 0 on a centre, 1/2 at the data's rim, 1 far off."""
        return self._both(percept, motion)[1]

    def predict_with_novelty(self, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Next percept (..., 7) and novelty (...), from one kernel evaluation."""
        return self._both(percept, motion)

    def features(self, percept: Tensor, motion: Tensor) -> Tensor:
        """The standardised features (..., 6) that the machine sees."""
        raw = geometry.turn_features(geometry.to_parts(percept), motion)
        return (raw.to(self.mean) - self.mean) / self.scale

    def _both(self, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        geometry.check_percept(percept, motion)
        parts = geometry.to_parts(percept)
        residual, distance = self.machine.values_and_distance(self.features(percept, motion))
        residual = (residual * self.residual_scale).to(percept.dtype)
        following = geometry.from_parts(geometry.move_rigidly(parts, motion) + residual)
        return following, (1 - torch.exp2(-distance / self.reach)).to(percept.dtype)


def _standardiser(features: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (d,) of rows (n, d), 1 where a feature is constant."""
    spread = features.std(0, correction=0)
    mean = features.mean(0)
    constant = spread <= 1e-9 * (1 + mean.abs())
    return mean, torch.where(constant, 1.0, spread)


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
        percept: Percepts before (n, 7), m.
        motion: Motions (n, 3), m and rad.
        next_percept: Percepts after (n, 7), m.
        seed: Seed or generator of folds, subset and solver.
        folds: Number of folds.
        C: Costs to try, in units of the standardised residuals.
        gamma: Kernel widths to try.
        epsilon: Tube widths to try.
        grid_rows: Random rows that the grid is scored on, None for all.
        progress: Called with (cells done, all cells).
        max_memory: Bytes that kernel matrices may take.
        dtype: Type of the returned model's buffers.

    Returns:
        The model and the report.

    Raises:
        DataError: Wrong shapes, NaN, too few rows or too many.
        SettingsError: A grid that cannot be used.
    """
    p, u, q = (
        inputs.as_rows(values, name)
        for values, name in (
            (percept, "percept"), (motion, "motion"), (next_percept, "next_percept"),
        )
    )  # fmt: skip
    geometry.check_percept(p, u)
    if not len(p) == len(u) == len(q) or q.shape[1] != 7:
        raise DataError(
            f"percept, motion and next percept have {len(p)}, {len(u)} and {len(q)} rows of "
            f"{p.shape[1]}, {u.shape[1]} and {q.shape[1]}; pass equally many of 7, 3 and 7"
        )
    inputs.check_memory(len(p), max_memory)
    generator = inputs.generator_of(seed)
    parts = geometry.to_parts(p)
    rigid = geometry.move_rigidly(parts, u)
    residual = geometry.to_parts(q) - rigid
    model = TransitionModel().to(p.device)
    raw = geometry.turn_features(parts, u)
    model.mean, model.scale = _standardiser(raw)
    model.residual_scale = residual.square().mean(0).sqrt().clamp_min(1e-9)
    features, target = (raw - model.mean) / model.scale, residual / model.residual_scale

    some = torch.randperm(len(p), generator=generator)[: grid_rows or len(p)].to(p.device)
    numbers = plain_folds(len(some), folds, generator)
    grid = grid_search(
        SVR(max_memory=max_memory),
        features[some],
        target[some],
        C=C,
        gamma=gamma,
        epsilon=epsilon,
        folds=numbers,
        seed=generator,
        scoring="neg_mean_absolute_error",
        progress=progress,
    )
    learnt, choice, held_out = _choose(grid, target[some])
    gaps = _fit_machine(model.machine, features, target, learnt, choice, generator, max_memory)
    model.reach = rim(model.machine, features)
    predicted = geometry.from_parts(rigid[some] + held_out * model.residual_scale)
    report = TransitionReport(
        rows=len(p),
        coordinates=geometry.COORDINATES,
        error=tuple((predicted - q[some]).abs().mean(0).tolist()),
        rigid_error=tuple((geometry.from_parts(rigid[some]) - q[some]).abs().mean(0).tolist()),
        parts=geometry.PARTS,
        choice=tuple(c if use else None for c, use in zip(choice, learnt, strict=True)),
        gap=gaps,
        centres=len(model.machine.centres),
        grid_cost=tuple(grid.C.tolist()),
        grid_gamma=tuple(grid.gamma.tolist()),
        grid_epsilon=tuple(grid.epsilon.tolist()),
        grid_scores=grid.mean.tolist(),
        finished_by_smo=int((~grid.direct).sum()),
    )
    return model.to(dtype), report


def _choose(grid: GridResult, target: Tensor) -> tuple[list[bool], tuple[Choice, ...], Tensor]:
    """Which parts are worth learning, their cells at a common gamma, and the held-out residuals.

    A part is learnt if its cross-validated error is below that of zero by more than the standard
    error of the difference over rows.
    """
    learnt, held_out = [], torch.zeros_like(target)
    score = grid.mean
    baseline = -target.abs().mean(0)
    gain = (score - baseline).clamp_min(0).flatten(1, 2).amax(1).sum(1)
    g = int(gain.argmax())
    choice = []
    for k in range(target.shape[1]):
        e, c = torch.unravel_index(score[g, :, :, k].argmax(), score[g, :, :, k].shape)
        value = grid.held_out[g, e, c, k]
        better = target[:, k].abs() - (value - target[:, k]).abs()
        learnt.append(bool(better.mean() > better.std() / len(better) ** 0.5))
        if learnt[-1]:
            held_out[:, k] = value
        choice.append(
            Choice(
                C=float(grid.C[c]),
                gamma=float(grid.gamma[g]),
                epsilon=float(grid.epsilon[e]),
                score=float(score[g, e, c, k]),
            )
        )
    return learnt, tuple(choice), held_out


def _fit_machine(
    machine: SVR,
    features: Tensor,
    target: Tensor,
    learnt: list[bool],
    choice: tuple[Choice, ...],
    generator: torch.Generator,
    max_memory: int,
) -> tuple[float, ...]:
    """Fit the learnt parts on all rows and give every other part weights of zero."""
    gamma = choice[0].gamma
    index = torch.tensor([k for k, use in enumerate(learnt) if use], dtype=torch.long)
    beta, bias = torch.zeros_like(target.T), target.new_zeros(7)
    gap, cost, tube = target.new_zeros(7), target.new_zeros(7), target.new_zeros(7)
    if len(index):
        chosen = [choice[k] for k in index.tolist()]
        part = SVR(
            [c.C for c in chosen],
            gamma=gamma,
            epsilon=[c.epsilon for c in chosen],
            seed=generator,
            max_memory=max_memory,
        ).fit(features, target[:, index])
        beta[index[:, None], part.support] = part.weights.T
        bias[index], gap[index] = part.bias, part.gap
        cost[index], tube[index] = part.cost, part.tube
    else:
        beta[0, :_QUIET_CENTRES] = 1e-300  # centres only, to tell novelty from
    machine.set_params(gamma=gamma)
    machine._keep(features, beta, bias, gap, gamma)
    machine.cost, machine.tube = cost, tube
    machine.squeeze = torch.tensor(False, device=features.device)
    return tuple(gap.tolist())


def rim(machine: KernelMachine, features: Tensor) -> Tensor:
    """Squared distance () that 95 % of training rows have a centre other than themselves within."""
    some = features[:: max(1, len(features) // 1024)]
    distance = torch.cdist(some, machine.centres).square()
    distance = torch.where(distance < 1e-16, torch.inf, distance)
    nearest = distance.amin(1)
    nearest = nearest[torch.isfinite(nearest)]
    if len(nearest) == 0:
        return torch.ones_like(machine.gamma_value)
    return nearest.quantile(0.95).clamp_min(1e-12)
