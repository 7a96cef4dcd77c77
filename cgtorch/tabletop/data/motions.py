"""Motions that are worth trying: most end near the object, where a grasp may succeed."""

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.world.percepts import parts_of

NEAR = (0.3, 1.3)  # m between base and object where a grasp may be possible or not
WITHIN = 1.4  # m from the object, beyond which no arm can reach it
FARTHEST = 2.0  # m of a motion
BLIND = 0.3  # probability that motions go in any direction, from which Γ learns


def motions_to_try(percept: Tensor, count: int, generator: Generator) -> Tensor:
    """(n, 3) random motions for a percept (D,), uniform in side, heading and distance.

    What is too far for one motion is approached.
    """
    if float(torch.rand((), generator=generator)) < BLIND:
        return random_motions(count, generator)
    part = torch.rand(count, 3, generator=generator)
    distance = NEAR[0] + (NEAR[1] - NEAR[0]) * part[:, 0]
    bearing, heading = (torch.pi * (2 * part[:, 1:] - 1)).unbind(1)
    offset = torch.stack([distance * bearing.cos(), distance * bearing.sin()], 1)
    to = parts_of(percept).object + offset
    to = to * (FARTHEST / to.norm(dim=1, keepdim=True).clamp_min(1e-6)).clamp_max(1)
    return torch.cat([to, heading[:, None]], 1)


def random_motions(count: int, generator: Generator) -> Tensor:
    """(n, 3) motions in random directions; a third turn very little, the others by any angle."""
    draw = torch.rand(count, 4, generator=generator)
    length, direction = FARTHEST * draw[:, 0], 2 * torch.pi * draw[:, 1]
    turn = torch.pi * (2 * draw[:, 2] - 1)
    turn = torch.where(draw[:, 3] < 1 / 3, turn / 12, turn)
    return torch.stack([length * direction.cos(), length * direction.sin(), turn], 1)
