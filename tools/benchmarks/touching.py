"""Collision tests of postures, beside pytorch-kinematics in torch."""

from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import pad

from benchmarks.measure import (
    CPU,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    in_turns,
    run_threads,
)
from cgtorch.tabletop.kinematics import ArmModel, load_robot
from cgtorch.tabletop.kinematics.clear_ways import (
    HELD,
    MARGIN,
    OBJECT,
    POSTURE,
    TABLE,
    Places,
    Scene,
    ways_clear,
)
from cgtorch.tabletop.kinematics.grasping import places_of
from cgtorch.tabletop.kinematics.scene import random_postures
from cgtorch.tabletop.kinematics.solids import fixed_solids

AT = torch.tensor([[0.9, 0.1, 0.3, 0.8, 1.2, 0.7]], dtype=torch.float64)
NEAR = 0.03  # m: pairs that are farther apart are not looked at
BORDERLINE = 1e-3
"""The share of postures whose results may differ, as rounding decides them."""


def touching(effort: Effort) -> Line:
    """Frames and solids of random postures in one pass, against one after the other."""
    with run_threads(1):
        parts = tuple(_of_robot(name, int(4000 * effort.size), effort) for name in ("pr2", "fetch"))
    return Line(
        name="touching",
        compared="whether arms touch a table or their body / frames by pytorch-kinematics and "
        "distances of solids in torch, float64, one thread",
        unit="x faster",
        target=4.0,
        clock="CPU",
        threads=1,
        parts=parts,
    )


def _of_robot(name: str, count: int, effort: Effort) -> Comparison:
    robot = load_robot(description=name)
    arm, scene = robot.arms[0], robot.scenes[0]
    q = random_postures(arm, count)
    places, kind = (
        places_of(AT[:, :3], AT)[torch.zeros(count).long()],
        torch.full((count,), POSTURE),
    )
    ours = partial(ways_clear, arm, scene, places, kind, q[:, None])
    other = partial(gaps, arm, scene, places, q, POSTURE)
    clear, (low, high) = ours(), (bound.amin(1) for bound in other())
    gap = float(torch.where(clear, high < MARGIN, low > MARGIN).double().mean())
    if gap > BORDERLINE:
        raise DisagreementError(f"{gap:.1%} of postures are said otherwise; nothing was timed")
    ours, other = in_turns((ours, other), effort.repeats, CPU, calls=[5, 1])
    return Comparison(
        label=f"{name}, {count} postures",
        ours=ours,
        other=other,
        ratio=other.median / ours.median,
        difference=gap,
        sizes={"postures": count, "joints": q.shape[1]},
        note=f"{count / ours.median:.3g} postures/s",
    )


def gaps(
    arm: ArmModel, scene: Scene, places: Places, q: Tensor, kinds: int
) -> tuple[Tensor, Tensor]:
    """Bounds of the distances of pairs (B, P) in postures (B, n), infinite if it is large, m."""
    pose, size = scene.pose.repeat(len(q), 1, 1, 1), scene.size.repeat(len(q), 1, 1)
    pose[:, TABLE], pose[:, OBJECT], pose[:, HELD] = places.table, places.object, places.held
    size[:, TABLE] = places.table_size
    moves = (scene.frame >= 0).nonzero()[:, 0]
    carrier = arm.frames(q)[scene.frame[moves]].transpose(0, 1)
    moved = carrier[..., :3, :3] @ pose[:, moves]
    pose[:, moves] = moved + pad(carrier[..., :3, 3:], (3, 0))
    radius = fixed_solids(pose.flatten(0, 1), size.flatten(0, 1)).radius.view(len(q), -1)
    a, b, kind = scene.pairs.unbind(1)
    away = (pose[:, a, :, 3] - pose[:, b, :, 3]).norm(dim=-1) - radius[:, a] - radius[:, b]
    row, pair = ((away < NEAR) & (kind & kinds > 0)).nonzero(as_tuple=True)
    a, b = a[pair], b[pair]
    found = _bounds(pose[row, a], size[row, a], pose[row, b], size[row, b])
    low, high = (torch.full_like(away, torch.inf).index_put((row, pair), x) for x in found)
    return low, high


def _bounds(a: Tensor, size: Tensor, b: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """Bounds (M,) of distances of solids (M, 3, 4) of sizes (M, 5) by Gilbert's iteration, m.

    It needs no simplex ("An iterative procedure for computing the minimum of a quadratic form on a
    convex set", 1966).
    """
    balls, away = size[:, 4] + other[:, 4], a[..., 3] - b[..., 3]
    least = torch.full_like(balls, -torch.inf)
    for _ in range(60):
        new = _farthest(a, size, -away) - _farthest(b, other, away)
        length, step = away.norm(dim=1).clamp_min(1e-12), away - new
        least = torch.maximum(least, (away * new).sum(1) / length)
        share = (away * step).sum(1) / step.square().sum(1).clamp_min(1e-30)
        away = away - share.clamp(0, 1)[:, None] * step
    return least - balls, away.norm(dim=1) - balls


def _farthest(pose: Tensor, size: Tensor, way: Tensor) -> Tensor:
    """(M, 3) the points of solids without their balls that are farthest in directions (M, 3)."""
    local = (way[:, None] @ pose[..., :3]).squeeze(1)
    at = torch.where(local < 0, -size[:, :3], size[:, :3])
    flat = local[:, :2] / local[:, :2].norm(dim=1, keepdim=True).clamp_min(1e-30)
    at = at + pad(size[:, 3:4] * flat, (0, 1))
    return (pose[..., :3] @ at[..., None]).squeeze(-1) + pose[..., 3]
