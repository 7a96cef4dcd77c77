"""Which motions MoveBase can carry out: those that are clear of the table and of obstacles.

In torch, separating axes of two rectangles are tested in columns: thousands of motions at once, so
every operation works on n adjacent numbers, x of all motions, then y of all motions.
"""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.environment import rows_where
from cgtorch.native import function, structure, suits, threads_worth
from cgtorch.tabletop.world.geometry import wrap
from cgtorch.tabletop.world.percepts import parts_of, present

MAX_TRANSLATION = 2.5  # m; a navigation goal further away is refused
CLEARANCE = 0.02  # m kept between base and table, four times the odometry noise
TURN_STEP = math.radians(15)  # a corner of the PR2 protrudes 4 mm between two such steps
WORTH_SHARING = 4096  # motions that are worth one more thread


def motion_possible(
    motion: Tensor, things: Tensor, footprint: Tensor, farthest: float = MAX_TRANSLATION
) -> Tensor:
    """(n,) bool, whether the base can make motions (n, 3) beside things in its frame.

    False if the swept footprint (4,) would come within `CLEARANCE` of one of them, for distances of
    more than `farthest` m, and for motions that are not finite. Things are a table (n, 5), or the
    table and obstacles (n, R, 5); a thing of size 0 is absent.
    """
    if things.dim() == 2:
        things = things[:, None]
    call = function("motions_possible", motion.dtype) if suits(motion, things, footprint) else None
    if call is None:
        return motion_possible_in_torch(motion, things, footprint, farthest)
    n, body = len(motion), body_structure(footprint, farthest)
    motion, things = motion.contiguous(), things.expand(n, -1, -1).contiguous()
    free, share = torch.empty(n, dtype=torch.bool), threads_worth(n, WORTH_SHARING)
    call(motion, things, body, n, things.shape[1], free, share)
    return free


def motion_possible_in_torch(
    motion: Tensor, things: Tensor, footprint: Tensor, farthest: float = MAX_TRANSLATION
) -> Tensor:
    """The same on any device, for things (n, R, 5)."""
    short = motion[:, :2].norm(dim=1) <= farthest
    free = short & torch.isfinite(motion).all(1)
    for thing in things.unbind(1):
        free = free & ~(present(thing) & sweep_blocked(motion, thing, footprint, CLEARANCE))
    return free


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class ClearMotion:
    """MoveBase's own check on percepts: the motion must be clear of table and obstacles as seen.

    Attributes:
        footprint: (4,) of the base (m).
    """

    footprint: Tensor

    def __call__(self, percept: Tensor, motion: Tensor) -> Tensor:
        """(n,) bool for percepts (n, D) and motions (n, 3)."""
        return motion_possible(motion, parts_of(percept).things, self.footprint)


def body_structure(footprint: Tensor, farthest: float = MAX_TRANSLATION) -> Any:
    """The base in the form of compiled code."""
    x0, x1, y0, y1 = footprint.tolist()
    return structure("Body", footprint.dtype)(
        bx=(x0 + x1) / 2,
        by=(y0 + y1) / 2,
        hx=(x1 - x0) / 2 + CLEARANCE,
        hy=(y1 - y0) / 2 + CLEARANCE,
        farthest=farthest,
    )


@dataclass(frozen=True)
class _Body:
    """The footprint seen from above: its `centre` and `half` sides (2,) in the base frame (m)."""

    centre: Tensor
    half: Tensor


def sweep_blocked(
    motion: Tensor, rectangle: Tensor, footprint: Tensor, clearance: float = 0.0
) -> Tensor:
    """(n,) bool, whether a footprint (4,) that drives straight and then turns touches a rectangle.

    Motions (n, 3) dx, dy (m), dθ (rad) and rectangles (n, 5) are in the robot's frame before it
    moves; the clearance (m) is kept on every side. A motion that is not finite counts as blocked.
    """
    low, high = footprint[0::2], footprint[1::2]
    body = _Body((low + high) / 2, (high - low) / 2 + clearance)
    motion, rectangle = motion.mT.contiguous(), rectangle.mT.contiguous()
    blocked = _drive_blocked(motion, rectangle, body) | ~motion.isfinite().all(0)
    # Only where the drive is free does the turn matter, and only where something is near.
    turning = ~blocked & (motion[2] != 0) & _within_reach(motion, rectangle, body)
    rows = rows_where(turning)
    if len(rows):
        hits = _turn_blocked(motion[:, rows], rectangle[:, rows], body)
        blocked[rows] |= turning[rows] & hits
    return blocked


def _drive_blocked(motion: Tensor, rectangle: Tensor, body: _Body) -> Tensor:
    """(n,) bool, whether the hull of the body before and after the drive meets the rectangle.

    Convex shapes are apart if a normal separates them: the body's, the rectangle's or the drive's.
    """
    dx, dy, _ = motion
    x, y, yaw, *size = rectangle
    (bx, by), (hx, hy) = body.centre, body.half
    x, y, w, h = x - bx, y - by, size[0] / 2, size[1] / 2
    c, s = yaw.cos(), yaw.sin()
    along, across = dx * c + dy * s, dy * c - dx * s  # the way driven, in the rectangle's frame
    ac, as_ = c.abs(), s.abs()
    apart = _beyond(x, dx, hx + ac * w + as_ * h)
    apart |= _beyond(y, dy, hy + as_ * w + ac * h)
    apart |= _beyond(x * c + y * s, along, w + ac * hx + as_ * hy)
    apart |= _beyond(y * c - x * s, across, h + as_ * hx + ac * hy)
    reach = dy.abs() * hx + dx.abs() * hy + across.abs() * w + along.abs() * h
    apart |= (y * dx - x * dy).abs() > reach
    return ~apart


def _beyond(place: Tensor, way: Tensor, reach: Tensor) -> Tensor:
    """(n,) bool, whether a place is further than `reach` from all of [0, way] or [way, 0]."""
    return (place - way.clamp_min(0) > reach) | (place - way.clamp_max(0) < -reach)


def _within_reach(motion: Tensor, rectangle: Tensor, body: _Body) -> Tensor:
    """(n,) bool, whether the circle that the body turns in touches the rectangle."""
    dx, dy, _ = motion
    x, y, yaw, *size = rectangle
    x, y, c, s = x - dx, y - dy, yaw.cos(), yaw.sin()
    along = ((x * c + y * s).abs() - size[0] / 2).clamp_min(0)
    across = ((y * c - x * s).abs() - size[1] / 2).clamp_min(0)
    radius = (body.centre.abs() + body.half).square().sum()
    return along.square() + across.square() < radius


def _turn_blocked(motion: Tensor, rectangle: Tensor, body: _Body) -> Tensor:
    """(n,) bool, whether the turn after the drive meets it, tested every `TURN_STEP` or less."""
    steps = math.ceil(math.pi / TURN_STEP)
    share = torch.linspace(1 / steps, 1, steps, dtype=motion.dtype, device=motion.device)
    turned = share[:, None] * wrap(motion[2])
    x, y, yaw, *size = rectangle
    x, y, w, h = x - motion[0], y - motion[1], size[0] / 2, size[1] / 2
    (bx, by), (hx, hy) = body.centre, body.half
    c, s = turned.cos(), turned.sin()
    x, y = c * x + s * y - bx, c * y - s * x - by
    c, s = (yaw - turned).cos(), (yaw - turned).sin()
    ac, as_ = c.abs(), s.abs()
    apart = x.abs() > hx + ac * w + as_ * h
    apart |= y.abs() > hy + as_ * w + ac * h
    apart |= (x * c + y * s).abs() > w + ac * hx + as_ * hy
    apart |= (y * c - x * s).abs() > h + as_ * hx + ac * hy
    return (~apart).any(0)
