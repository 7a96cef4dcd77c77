"""The home posture: where the arms are while the robot drives, and where every way begins."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.collision import Boxes
from cgtorch.tabletop.kinematics.touching import touches

SAMPLES, TRIED = 16_384, 512
ABOVE = 1.0  # m: what is beyond the footprint stays above tables
BELOW_COSTS = 4.0
"""How much worse it is to be beyond the footprint and low, or on the other arm's side, than far
beyond the footprint."""


def home_postures(
    arms: tuple[ArmModel, ...],
    body: Boxes,
    footprint: tuple[float, float, float, float],
    named: Mapping[str, float],
) -> tuple[Tensor, ...]:
    """A posture (n,) of each arm, rad or m: what a description names, else one that is computed."""
    if named:
        return tuple(_named(arm, named) for arm in arms)
    return tuple(_computed(arm, body, footprint) for arm in arms)


def _named(arm: ArmModel, named: Mapping[str, float]) -> Tensor:
    zero = torch.zeros_like(arm.lower).clamp(arm.lower, arm.upper)
    given = [named.get(name, float(at)) for name, at in zip(arm.joint_names, zero, strict=True)]
    return torch.tensor(given, dtype=arm.lower.dtype)


def _computed(arm: ArmModel, body: Boxes, footprint: tuple[float, float, float, float]) -> Tensor:
    """The one of many random postures, clear of the body, that is raised and near to the body."""
    generator = torch.Generator().manual_seed(0)
    low = torch.where(arm.continuous, -math.pi, arm.lower)
    high = torch.where(arm.continuous, math.pi, arm.upper)
    share = torch.rand(SAMPLES, len(low), generator=generator, dtype=low.dtype)
    q = low + share * (high - low)
    start, end = arm.capsules.to(q).placed(arm.frames(q))
    points, radius = torch.cat([start, end], 1), arm.capsules.radius.repeat(2)
    x_min, x_max, y_min, y_max = footprint
    corner = points.new_tensor([[x_max, y_max], [x_min, y_min]])
    beyond = torch.maximum(points[..., :2] - corner[0], corner[1] - points[..., :2])
    beyond = (beyond.amax(-1) + radius).clamp_min(0)
    under = torch.minimum(beyond, (ABOVE + radius - points[..., 2]).clamp_min(0)).amax(1)
    side = math.copysign(1.0, float(arm.mount[1, 3])) if abs(float(arm.mount[1, 3])) > 0.01 else 0.0
    crossed = (radius - side * points[..., 1]).clamp_min(0).amax(1) if side else 0.0
    best = q[(beyond.amax(1) + BELOW_COSTS * (under + crossed)).argsort()[:TRIED]]
    free = ~touches(arm, best, body[:0][None].to(best), body.to(best))
    return best[int(free.long().argmax())]
