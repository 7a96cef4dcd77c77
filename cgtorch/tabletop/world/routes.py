"""Routes of the base around what is seen: the first of several straight motions to a pose."""

import torch
from torch import Tensor

from cgtorch.tabletop.world.clear_motion import CLEARANCE, motion_possible
from cgtorch.tabletop.world.geometry import corners, rotate, wrap
from cgtorch.tabletop.world.percepts import parts_of, present

LONGEST = 1.9
"""The longest motion (m); Γ has seen motions of up to 2 m."""
VIAS = 3
"""The largest number of corners on a route."""
WORTH_TURNING = 0.001
"""How much shorter (m) a route that turns at its first corner must be than one that turns last."""
AWAY = 0.05
"""The distance (m) from the base within which a corner has been passed."""
ROOM = 1.05
"""The distance at which corners are passed, in units of what the base needs to turn there."""


def first_motion(percept: Tensor, motion: Tensor, footprint: Tensor) -> Tensor:
    """The first motion (n, 3) of the shortest route found to the goals of motions (n, 3).

    It is the motion itself if that is clear of what percepts (n, D) show, or if no route is found.
    Routes lead past corners of the table and of obstacles, far enough from each for the footprint
    (4,) to turn there: a visibility graph (Lozano-Pérez and Wesley 1979). The base drives them with
    its present heading, or turns to its final heading at the first corner. A motion longer than
    `LONGEST` is cut to that length, without a turn.
    """
    seen = parts_of(percept).things
    corner = corners(_wider(seen, footprint)).flatten(1, 2)
    there = present(seen).repeat_interleave(4, 1)
    straight = _possible(motion[:, None], seen, footprint)[:, 0]
    best, total = motion, motion.new_full((len(motion),), torch.inf)
    for turn in (motion.new_zeros(len(motion)), motion[:, 2]):
        length, first = _shortest(seen, corner, there, motion, turn, footprint)
        at = corner.take_along_dim(first[:, None, None], 1)[:, 0]
        shorter = length < total - WORTH_TURNING
        via = torch.cat([at, turn[:, None]], 1)
        best = torch.where(shorter[:, None], via, best)
        total = torch.where(shorter, length, total)
    best = torch.where(straight[:, None], motion, best)
    found = straight | total.isfinite()
    distance = best[:, :2].norm(dim=1)
    part = torch.cat(
        [best[:, :2] * (LONGEST / distance)[:, None], torch.zeros_like(best[:, 2:])], 1
    )
    return torch.where((found & (distance > LONGEST))[:, None], part, best)


def _shortest(
    seen: Tensor, corner: Tensor, there: Tensor, motion: Tensor, turn: Tensor, footprint: Tensor
) -> tuple[Tensor, Tensor]:
    """Lengths (n,) of routes past corners (n, J, 2), inf for none, and their first corners (n,).

    The base turns by `turn` (n,) at the first corner, and by the rest at the end.
    """
    n, j, _ = corner.shape
    to_first = torch.cat([corner, turn[:, None, None].expand(n, j, 1)], 2)
    far = corner.norm(dim=2)
    length = _or_inf(far, there & (far > AWAY) & _possible(to_first, seen, footprint))
    first = torch.arange(j, device=corner.device).expand(n, j)
    # The percept after the turn, in the frame of the start.
    turned, things = rotate(corner, -turn[:, None]), _turned(seen, turn)
    goal = rotate(motion[:, :2], -turn)
    between = turned[:, None] - turned[:, :, None]
    onward = torch.cat([between, torch.zeros_like(between[..., :1])], 3)
    free = there[:, None] & _possible_from(turned, onward, things, footprint)
    step = _or_inf(between.norm(dim=3), free)
    for _ in range(VIAS - 1):
        further = (length[:, :, None] + step).min(1)
        first = torch.where(further.values < length, first.gather(1, further.indices), first)
        length = torch.minimum(length, further.values)
    left = goal[:, None] - turned
    turns = wrap(motion[:, 2] - turn)[:, None, None].expand(n, j, 1)
    last = torch.cat([left, turns], 2)[:, :, None]
    ends = _possible_from(turned, last, things, footprint)[:, :, 0]
    whole = (length + _or_inf(left.norm(dim=2), ends)).min(1)
    return whole.values, first.gather(1, whole.indices[:, None])[:, 0]


def _possible(motion: Tensor, things: Tensor, footprint: Tensor) -> Tensor:
    """(n, J) bool, whether motions (n, J, 3) are possible beside things (n, R, 5)."""
    n, j, _ = motion.shape
    each = things[:, None].expand(n, j, *things.shape[1:]).flatten(0, 1)
    return motion_possible(motion.reshape(-1, 3), each, footprint, torch.inf).view(n, j)


def _possible_from(place: Tensor, motion: Tensor, things: Tensor, footprint: Tensor) -> Tensor:
    """(n, J, M) bool, whether motions (n, J, M, 3) from places (n, J, 2) are possible."""
    n, j, m, _ = motion.shape
    around = things[:, None].expand(n, j, *things.shape[1:])
    around = torch.cat([around[..., :2] - place[:, :, None], around[..., 2:]], 3)
    return _possible(motion.flatten(0, 1), around.flatten(0, 1), footprint).view(n, j, m)


def _turned(things: Tensor, turn: Tensor) -> Tensor:
    """Things (n, R, 5) as seen by a base that has turned by `turn` (n,)."""
    turn = turn[:, None]
    centre, yaw = rotate(things[..., :2], -turn), wrap(things[..., 2] - turn)
    return torch.cat([centre, yaw[..., None], things[..., 3:]], -1)


def _wider(things: Tensor, footprint: Tensor) -> Tensor:
    """Things (n, R, 5), enlarged on each side by what the base needs to turn there."""
    reach = ROOM * (footprint.view(2, 2).abs().amax(1) + CLEARANCE).norm()
    return torch.cat([things[..., :3], things[..., 3:] + 2 * reach], -1)


def _or_inf(length: Tensor, there: Tensor) -> Tensor:
    return torch.where(there, length, torch.inf)
