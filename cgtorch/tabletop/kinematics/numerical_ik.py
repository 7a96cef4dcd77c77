"""Inverse kinematics by damped least squares, for arms without a closed form."""

from typing import Any

import torch
from torch import Tensor

SEEDS = 4096
STARTS = 6
ITERATIONS = 40
DAMPING = 1e-2
POSITION_TOLERANCE = 1e-4
ROTATION_TOLERANCE = 1e-3
_STEP = 0.5
_POSES = 1024  # solved at a time
_ROTATION_WEIGHT = 0.3


def numerical_candidates(
    chain: Any, lower: Tensor, upper: Tensor, pose: Tensor
) -> tuple[Tensor, Tensor]:
    """Like `ArmModel.candidates`, refined from the nearest of many sampled postures.

    Limits are (n,), rad or m; poses (B, 4, 4) are in the arm's base link.
    """
    generator = torch.Generator().manual_seed(0)
    spread = torch.rand(SEEDS, len(lower), generator=generator, dtype=torch.float64).to(lower)
    seeds = lower + (upper - lower) * spread
    reached = chain.forward_kinematics(seeds, end_only=True).get_matrix()
    every = torch.arange(len(pose), device=pose.device)
    rows, solutions = [], []
    for part, row in zip(pose.split(_POSES), every.split(_POSES), strict=True):
        away = torch.cdist(_key(part), _key(reached))
        nearest = away.topk(STARTS, largest=False).indices
        target = part.repeat_interleave(STARTS, dim=0)
        q, converged = _refine(chain, lower, upper, seeds[nearest.flatten()], target)
        rows.append(row.repeat_interleave(STARTS)[converged])
        solutions.append(q[converged])
    return torch.cat(rows), torch.cat(solutions)


def _key(pose: Tensor) -> Tensor:
    """(B, 12): poses as points, whose distances weigh position against rotation."""
    return torch.cat([pose[:, :3, 3], _ROTATION_WEIGHT * pose[:, :3, :3].flatten(1)], dim=1)


def numerical_follow(
    chain: Any, lower: Tensor, upper: Tensor, q: Tensor, pose: Tensor
) -> tuple[Tensor, Tensor]:
    """Like `ArmModel.follow`, with each waypoint refined from q; see `numerical_candidates`."""
    count, steps = pose.shape[:2]
    start = q.repeat_interleave(steps, dim=0)
    path, converged = _refine(chain, lower, upper, start, pose.reshape(-1, 4, 4))
    return path.reshape(count, steps, len(lower)), converged.reshape(count, steps)


def _refine(
    chain: Any, lower: Tensor, upper: Tensor, q: Tensor, pose: Tensor
) -> tuple[Tensor, Tensor]:
    """Joint positions (B, n) within limits, refined from q (B, n), and which reach poses (B,)."""
    q = q.clone()
    converged = torch.zeros(len(q), dtype=torch.bool, device=q.device)
    active = torch.arange(len(q), device=q.device)
    for iteration in range(ITERATIONS + 1):
        if not len(active):
            break
        jacobian, reached = chain.jacobian(q[active], ret_eef_pose=True)
        error = _error(reached, pose[active])
        done = (error[:, :3].norm(dim=1) < POSITION_TOLERANCE) & (
            error[:, 3:].norm(dim=1) < ROTATION_TOLERANCE
        )
        converged[active[done]] = True
        active, jacobian, error = active[~done], jacobian[~done], error[~done]
        if iteration == ITERATIONS:
            break
        damping = (DAMPING * error.norm(dim=1)).clamp_max(DAMPING)[:, None, None]
        eye = torch.eye(6, dtype=q.dtype, device=q.device)
        square = jacobian @ jacobian.transpose(1, 2) + (damping + 1e-7) * eye
        step = (jacobian.transpose(1, 2) @ torch.linalg.solve(square, error[..., None])).squeeze(-1)
        longest = step.abs().amax(dim=1, keepdim=True)
        step = step * (_STEP / longest.clamp_min(_STEP))
        q[active] = torch.maximum(torch.minimum(q[active] + step, upper), lower)
    return q, converged


def _error(reached: Tensor, wanted: Tensor) -> Tensor:
    """(B, 6): the remaining translation (m) and rotation (rotation vector), in the base frame."""
    turn = wanted[:, :3, :3] @ reached[:, :3, :3].transpose(1, 2)
    twist = (turn - turn.transpose(1, 2)) / 2
    skew = torch.stack([twist[:, 2, 1], twist[:, 0, 2], twist[:, 1, 0]], dim=1)
    sine = skew.norm(dim=1)
    cosine = (turn.diagonal(dim1=1, dim2=2).sum(-1) - 1) / 2
    angle = torch.atan2(sine, cosine)
    scale = torch.where(sine > 1e-6, angle / sine.clamp_min(1e-6), torch.ones_like(sine))
    return torch.cat([wanted[:, :3, 3] - reached[:, :3, 3], skew * scale[:, None]], dim=1)
