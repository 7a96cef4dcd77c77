"""Where arms are while the base drives, and how they get from there to a grasp.

The world asks only whether a grasp exists, with its pre-grasp and lift; how the arm comes to the
pre-grasp is nobody's business there. For the eye it needs a way that touches nothing.
"""

import itertools
import math
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.kinematics import ArmModel, Robot
from cgtorch.tabletop.kinematics.collision import Boxes
from cgtorch.tabletop.kinematics.grasping import table_slab
from cgtorch.tabletop.kinematics.touching import touches

SAMPLES, TRIED = 16_384, 512
APART = 4
"""How much worse it is to cross over to the other arm than to reach beyond the footprint."""
VIAS, FEW = 512, 24
"""Postures to go through, and how many of these are tried in pairs."""
COARSE, FINE = 10, 200
"""Postures that are looked at between two, of all ways and of those that seem free."""
SAME = 0.02
"""How far apart two arms may be for one to count as the mirror image of the other, m."""


def rest_postures(robot: Robot) -> tuple[Tensor, ...]:
    """A posture (n,) of each arm that is folded beside the body, rad or m.

    It is the one of many random ones that reaches least beyond the footprint, on the arm's
    own side and clear of the body. An arm that can mirror an earlier one does.
    """
    found: list[Tensor] = []
    for arm in robot.arms:
        images = (_mirrored(arm, *pair) for pair in zip(robot.arms, found, strict=False))
        image = next((q for q in images if q is not None), None)
        found.append(_folded(robot, arm) if image is None else image)
    return tuple(found)


def _folded(robot: Robot, arm: ArmModel) -> Tensor:
    q = _random_postures(arm, SAMPLES)
    points, radius = _points(arm, q), arm.capsules.radius.repeat(2)
    x_min, x_max, y_min, y_max = robot.description.footprint
    low, high = points.new_tensor([x_min, y_min]), points.new_tensor([x_max, y_max])
    beyond = torch.maximum(points[..., :2] - high, low - points[..., :2]) + radius[:, None]
    side = math.copysign(1.0, float(arm.mount[1, 3]))
    crossed = (radius - side * points[..., 1]).clamp_min(0).amax(1)
    best = q[(beyond.clamp_min(0).amax(1).sum(1) + APART * crossed).argsort()[:TRIED]]
    no_table = robot.body[:0][None].to(best)
    free = ~touches(arm, best, no_table, robot.body.to(best))
    return best[int(free.long().argmax())]


def _mirrored(arm: ArmModel, other: ArmModel, q: Tensor) -> Tensor | None:
    """The posture (n,) that mirrors another arm's, if there is one."""
    if len(arm.joint_names) != len(other.joint_names):
        return None
    signs = torch.tensor(list(itertools.product((1.0, -1.0), repeat=len(q))), dtype=q.dtype)
    tried = signs * q
    tried = tried[((tried >= arm.lower) & (tried <= arm.upper)).all(1)]
    image = _points(other, q[None]) * torch.tensor([1.0, -1.0, 1.0])
    if not len(tried):
        return None
    # Left and right fingers change places, so any end may be the image of any.
    away = torch.cdist(_points(arm, tried), image).amin(2).amax(1)
    return tried[away.argmin()] if float(away.min()) < SAME else None


def way_to(robot: Robot, arm: ArmModel, start: Tensor, goal: Tensor, table: Tensor) -> Tensor:
    """Postures (W, n) from `start` to `goal` without touching the table or the body, ends included.

    Straight in joint space (rad or m) or, where that touches something, through one or two random
    postures with which it does not, as in a probabilistic roadmap (Kavraki et al. 1996). If none of
    them serves, it is straight nevertheless. The table (6,) is in the base frame.
    """
    goal = start + arm.difference(goal, start)
    free = partial(_free, arm, table_slab(table[None].to(goal)), robot.body.to(goal))
    vias = torch.cat([((start + goal) / 2)[None], _random_postures(arm, VIAS, around=start)])
    there, back = free(start.expand_as(vias), vias), free(vias, goal.expand_as(vias))
    ways = [torch.stack([start, via, goal]) for via in vias[there & back][:FEW]]
    if not ways:
        first, last = vias[there][:FEW], vias[back][:FEW]
        one, two = first.repeat_interleave(len(last), 0), last.repeat(len(first), 1)
        both = free(one, two)
        ways = [torch.stack([start, a, b, goal]) for a, b in zip(one[both], two[both], strict=True)]
    sound = (way for way in ways[:FEW] if free(way[:-1], way[1:], FINE).all())
    return next(sound, torch.stack([start, goal]))


def _free(
    arm: ArmModel, slab: Boxes, body: Boxes, a: Tensor, b: Tensor, steps: int = COARSE
) -> Tensor:
    """(K,) whether an arm touches nothing on straight lines from postures a to b (K, n)."""
    share = torch.linspace(0, 1, steps, dtype=a.dtype)[None, :, None]
    line = (a[:, None] + share * (b - a)[:, None]).flatten(0, 1)
    return ~touches(arm, line, slab, body).view(len(a), steps).any(1)


def _random_postures(arm: ArmModel, count: int, around: Tensor | None = None) -> Tensor:
    """(count, n) within limits; joints that turn without end within half a turn of `around`."""
    generator = Generator().manual_seed(0)
    share = torch.rand(count, len(arm.joint_names), generator=generator, dtype=arm.lower.dtype)
    middle = torch.zeros_like(arm.lower) if around is None else around
    low = torch.where(arm.continuous, middle - math.pi, arm.lower)
    high = torch.where(arm.continuous, middle + math.pi, arm.upper)
    return low + share * (high - low)


def _points(arm: ArmModel, q: Tensor) -> Tensor:
    """(B, 2 C, 3) both ends of all capsules, in the base frame."""
    start, end = arm.capsules.to(q).placed(arm.frames(q))
    return torch.cat([start, end], 1)
