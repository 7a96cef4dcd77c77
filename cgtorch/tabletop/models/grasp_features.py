"""What C sees of a percept: the object in polar coordinates, and the table as far as arms reach."""

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
    """Features (..., F) of tabletop percepts (..., D); errors are those of `parts_of`.

    An arm reaches a ring about its shoulder, not a box, so the object is given by its distance, the
    two numbers of its direction, and its height. Obstacles are reached over and left out. Of the
    table, F = 8: the four sides of its box come first, each saturated at `NEAR`, as what lies
    beyond the reach of the arms changes nothing; the height is last. Where the percept tells the
    table's yaw, F = 10: last come the two edges that the robot stands in front of (`edges`).
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
    """How the two edges of tables (..., 5) lie that the robot stands farthest in front of (..., 6).

    How far in front of either it stands, saturated at `NEAR`; how far from either the object
    (..., 2) stands (m); and the outward direction of the first, of length `NEAR`.
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
    """How many features of percepts (n, D) are worth learning from, counted from the first.

    All, but not the height of box percepts where all tables are as high.
    """
    seen = parts_of(percept)
    if seen.side.shape[-1]:
        return FLAT + 3
    return FLAT + int(bool(seen.height.std(correction=0) > SAME_HEIGHT))
