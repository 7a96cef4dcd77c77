"""Collision tests of postures, beside pytorch-kinematics in torch."""

import math
from functools import partial

import torch
from torch import Tensor

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
from cgtorch.tabletop.kinematics.clear_ways import BISECTIONS, SHOULDER_JOINTS, touches
from cgtorch.tabletop.kinematics.grasping import table_slab
from cgtorch.tabletop.kinematics.solids import Boxes

TABLE = torch.tensor([[0.9, 0.1, 0.3, 0.8, 1.2, 0.7]])
BORDERLINE = 1e-3
"""The share of postures whose results may differ, as rounding decides them."""


def touching(effort: Effort) -> Line:
    """Frames, capsules and boxes of random postures in one pass, against one after the other."""
    with run_threads(1):
        parts = tuple(_of_robot(name, int(4000 * effort.size), effort) for name in ("pr2", "fetch"))
    return Line(
        name="touching",
        compared="whether arms touch a table or their body / frames by pytorch-kinematics and "
        "capsules in torch, float32, one thread",
        unit="x faster",
        target=4.0,
        clock="CPU",
        threads=1,
        parts=parts,
    )


def _of_robot(name: str, count: int, effort: Effort) -> Comparison:
    robot, generator = load_robot(description=name), torch.Generator().manual_seed(0)
    arm = robot.arms[0]
    lower = torch.where(arm.continuous, -math.pi, arm.lower).float()
    upper = torch.where(arm.continuous, math.pi, arm.upper).float()
    q = lower + (upper - lower) * torch.rand(count, len(lower), generator=generator)
    asked = arm, q, table_slab(TABLE.expand(count, 6)), robot.body.to(q)
    gap = float((touches(*asked) != touches_in_torch(*asked)).float().mean())
    if gap > BORDERLINE:
        raise DisagreementError(f"{gap:.1%} of postures are said otherwise; nothing was timed")
    works = partial(touches, *asked), partial(touches_in_torch, *asked)
    ours, other = in_turns(works, effort.repeats, CPU, calls=[5, 1])
    return Comparison(
        label=f"{name}, {count} postures",
        ours=ours,
        other=other,
        ratio=other.median / ours.median,
        difference=gap,
        sizes={"postures": count, "joints": len(lower)},
        note=f"{count / ours.median:.3g} postures/s",
    )


def touches_in_torch(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor:
    """The same as `touches`, for all postures at once."""
    capsules = arm.capsules.to(q)
    loose = capsules.joints > SHOULDER_JOINTS
    hit = []
    for rows in torch.arange(len(q)).split(2048):  # more fall out of the processor's cache
        start, end = capsules.placed(arm.frames(q[rows]))
        table = _collide(start, end, capsules.radius, slab[rows])
        start, end, radius = start[:, loose], end[:, loose], capsules.radius[loose]
        hit.append(table | _collide(start, end, radius, body[None]))
    return torch.cat(hit)


def _collide(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor:
    """(B,) whether capsules, ends (B, C, 3), radius (C,), m, meet boxes (B or 1, N, ...)."""
    near = _close((start + end) / 2, (end - start).norm(dim=-1) / 2 + radius, boxes)
    row, capsule, box = near.nonzero(as_tuple=True)
    which = row if len(boxes.half) > 1 else torch.zeros_like(row)
    half, turn = boxes.half[which, box], boxes.rotation[which, box].transpose(-1, -2)
    a, b = (
        (turn @ (point[row, capsule] - boxes.centre[which, box])[..., None]).squeeze(-1)
        for point in (start, end)
    )
    hit = torch.zeros(len(start), dtype=torch.bool)
    hit[row[_distance(a, b - a, half) < radius[capsule]]] = True
    return hit


def _close(middle: Tensor, reach: Tensor, boxes: Boxes) -> Tensor:
    """(B, C, N) whether balls about capsules (B, C, 3) reach boxes, which is rare.

    Columns are computed one by one, as rows of three numbers are too short for vectorisation.
    """
    x, y, z = (middle[:, :, None, i] - boxes.centre[:, None, :, i] for i in range(3))
    away = torch.zeros_like(x)
    for i in range(3):
        axis = boxes.rotation[:, None, :, :, i]
        along = axis[..., 0] * x + axis[..., 1] * y + axis[..., 2] * z
        away = away + (along.abs() - boxes.half[:, None, :, i]).clamp_min(0).square()
    return away <= (1.00001 * reach).square()[:, :, None]


def _distance(start: Tensor, along: Tensor, half: Tensor) -> Tensor:
    """(M,) distances of segments (M, 3) and centred boxes (M, 3), by bisection on the slope, m."""

    def outside(share: Tensor | float) -> Tensor:
        point = start + share * along
        return point - point.clamp(-half, half)

    low, high = torch.zeros_like(start[:, :1]), torch.ones_like(start[:, :1])
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        rising = (outside(middle) * along).sum(-1, keepdim=True) > 0
        low, high = torch.where(rising, low, middle), torch.where(rising, middle, high)
    ends = [outside(share).norm(dim=-1) for share in (0.0, 1.0, (low + high) / 2)]
    return torch.stack(ends).amin(0)
