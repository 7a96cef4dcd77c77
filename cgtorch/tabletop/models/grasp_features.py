"""The features of C: the object in polar coordinates, and the table within reach of the arms."""

import torch
from torch import Tensor

from cgtorch.tabletop.world.percepts import parts_of

FLAT = 7  # features of box percepts, without the height, where all tables are as high
SAME_HEIGHT = 0.02  # m, a standard deviation of heights that is hardly more than noise
NEAR = 0.5  # m over which a side of the table stops to matter
STRETCH = 4.0  # weight of the object's distance, in which success changes over centimetres
TURN = 2.0  # weight of its direction
RISE = 3.0  # weight of its height, with which the reach of the arms changes
EDGES = 2  # that matter, those that the robot stands farthest in front of


def grasp_features(percept: Tensor) -> Tensor:
    """Features (..., F) of tabletop percepts (..., D); for errors see `parts_of`.

    An arm reaches a ring about its shoulder, so the object is given by its distance, the two
    numbers of its direction, and its height. Arms reach over obstacles, so these are left out. For
    box percepts, F = 8: the four sides of the table's box come first, each saturated at `NEAR`,
    since what lies beyond the arms changes nothing; the height is last. If the percept contains the
    table's yaw, F = 10: the two edges in front of which the robot is farthest out (`edges`) are
    last.
    """
    seen = parts_of(percept)
    placed = seen.object
    distance = placed.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    polar = torch.cat([STRETCH * distance, TURN * placed / distance], -1)
    height = RISE * seen.height
    if seen.side.shape[-1]:
        return torch.cat([polar, height, edges(seen.table, placed)], -1)
    return torch.cat([NEAR * torch.tanh(seen.box / NEAR), polar, height], -1)


def edges(table: Tensor, placed: Tensor) -> Tensor:
    """(..., 6), the two edges of tables (..., 5) in front of which the robot is farthest out.

    These are the robot's distances in front of them, saturated at `NEAR`; the distances of the
    object (..., 2) from them (m); and the outward direction of the first, of length `NEAR`.
    """
    c, s = table[..., 2].cos(), table[..., 2].sin()
    outward = torch.stack([c, s, -c, -s, -s, c, s, -c], -1).unflatten(-1, (4, 2))
    half = table[..., [3, 3, 4, 4]] / 2
    ahead = -(outward * table[..., None, :2]).sum(-1) - half
    inset = half - (outward * (placed - table[..., :2])[..., None, :]).sum(-1)
    order = ahead.argsort(-1, descending=True)[..., :EDGES]
    first = outward.gather(-2, order[..., :1, None].expand(*order.shape[:-1], 1, 2))[..., 0, :]
    ahead = NEAR * torch.tanh(ahead.gather(-1, order) / NEAR)
    return torch.cat([ahead, inset.gather(-1, order), NEAR * first], -1)


def used_features(percept: Tensor) -> int:
    """The number of features of percepts (n, D), from the first, that are informative.

    These are all, except the height of box percepts if all tables have the same height.
    """
    seen = parts_of(percept)
    if seen.side.shape[-1]:
        return FLAT + 3
    return FLAT + int(bool(seen.height.std(correction=0) > SAME_HEIGHT))
