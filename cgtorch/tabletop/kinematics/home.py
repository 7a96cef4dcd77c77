"""The home posture: that of the arms while the robot drives, where every way begins."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.collision import Boxes
from cgtorch.tabletop.kinematics.scene_pairs import clear_alone, random_postures, scene_of
from cgtorch.tabletop.kinematics.solids import boxes_as_solids

SAMPLES, TRIED = 16_384, 2048
CENTRE = 0.01  # m: an arm whose shoulder is nearer to the middle than this has no side of its own
ABOVE = 1.0  # m: what is beyond the footprint stays above tables
BELOW_COSTS = 4.0
"""The cost of being beyond the footprint and low, or on the other arm's side, relative to being far
beyond the footprint."""


def home_postures(
    arms: tuple[ArmModel, ...],
    body: Boxes,
    footprint: tuple[float, float, float, float],
    named: Mapping[str, float],
) -> tuple[Tensor, ...]:
    """A posture (n,) of each arm, rad or m: as the description names it, or else computed."""
    if named:
        return tuple(_named(arm, named) for arm in arms)
    return tuple(_computed(arm, body, footprint) for arm in arms)


def _named(arm: ArmModel, named: Mapping[str, float]) -> Tensor:
    zero = torch.zeros_like(arm.lower).clamp(arm.lower, arm.upper)
    given = [named.get(name, float(at)) for name, at in zip(arm.joint_names, zero, strict=True)]
    return torch.tensor(given, dtype=arm.lower.dtype)


def _computed(arm: ArmModel, body: Boxes, footprint: tuple[float, float, float, float]) -> Tensor:
    """The best of many random postures: raised, near the body, and clear of it.

    A hand below the height of tables would first have to come up past their edges.
    """
    q = random_postures(arm, SAMPLES)
    frames = arm.frames(q)
    start, end = arm.capsules.to(q).placed(frames)
    points, radius = torch.cat([start, end], 1), arm.capsules.radius.repeat(2)
    x_min, x_max, y_min, y_max = footprint
    corner = points.new_tensor([[x_max, y_max], [x_min, y_min]])
    beyond = torch.maximum(points[..., :2] - corner[0], corner[1] - points[..., :2])
    beyond = (beyond.amax(-1) + radius).clamp_min(0)
    under = torch.minimum(beyond, (ABOVE + radius - points[..., 2]).clamp_min(0)).amax(1)
    hand = arm.capsules.joints.repeat(2) > len(arm.lower) / 2
    low = (ABOVE + radius - points[..., 2]).clamp_min(0)[:, hand].amax(1)
    shoulder = float(
        frames[1, 0, 1, 3]
    )  # the y of the first joint; an arm may hang from the middle
    side = math.copysign(1.0, shoulder) if abs(shoulder) > CENTRE else 0
    crossed = (radius - side * points[..., 1]).clamp_min(0).amax(1) if side else 0.0
    best = q[(beyond.amax(1) + low + BELOW_COSTS * (under + crossed)).argsort()[:TRIED]]
    alone = scene_of(arm, boxes_as_solids(body), boxes_as_solids(body[:0]))
    return best[int(clear_alone(arm, alone, best).long().argmax())]
