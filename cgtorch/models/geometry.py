"""What the geometry of a percept says by itself, without data.

A percept (..., 7) is the table's axis-aligned box x min, x max, y min, y max and the object's
x, y, z; a motion (..., 3) is dx, dy and dθ: the robot translates by (dx, dy), holding its
heading, and then turns by dθ. Metres and radians in the robot's base frame.
"""

import torch
from torch import Tensor

from cgtorch.errors import DataError

COORDINATES = (
    "table x min", "table x max", "table y min", "table y max", "object x", "object y", "object z",
)  # fmt: skip
PARTS = (
    "table centre x", "table centre y", "table width", "table depth",
    "object x", "object y", "object z",
)  # fmt: skip
FEATURES = 6


def check_percept(percept: Tensor, motion: Tensor) -> None:
    """Refuse percepts that are not (..., 7) or motions that are not (..., 3).

    Raises:
        DataError: Another last dimension.
    """
    if percept.shape[-1:] != (7,) or motion.shape[-1:] != (3,):
        raise DataError(
            f"percept has shape {tuple(percept.shape)} and motion {tuple(motion.shape)}; "
            "pass (..., 7) and (..., 3)"
        )


def to_parts(percept: Tensor) -> Tensor:
    """Box centre x, y, extents along x, y and object x, y, z (..., 7) of a percept (..., 7)."""
    low, high = percept[..., 0:4:2], percept[..., 1:4:2]
    return torch.cat([(low + high) / 2, high - low, percept[..., 4:]], dim=-1)


def from_parts(parts: Tensor) -> Tensor:
    """The percept (..., 7) with the given parts (..., 7), the inverse of `to_parts`."""
    centre, half = parts[..., 0:2], parts[..., 2:4] / 2
    box = torch.stack([centre - half, centre + half], dim=-1)
    return torch.cat([box.flatten(-2), parts[..., 4:]], dim=-1)


def move_rigidly(parts: Tensor, motion: Tensor) -> Tensor:
    """Parts (..., 7) after the robot's motion (..., 3), the box's extents kept.

    A point moves as R(-dθ)(point - (dx, dy)), and so does the centre of the box, because the
    table is a centrally symmetric rectangle. The extents are the only part that the turn leaves
    open: they depend on the rectangle inside the box, which the percept does not show.
    """
    dx, dy, cos, sin = motion[..., 0], motion[..., 1], motion[..., 2].cos(), motion[..., 2].sin()
    columns = list(parts.unbind(-1))
    for x, y in ((0, 1), (4, 5)):
        px, py = parts[..., x] - dx, parts[..., y] - dy
        columns[x], columns[y] = cos * px + sin * py, cos * py - sin * px
    return torch.stack(torch.broadcast_tensors(*columns), dim=-1)


def turn_features(parts: Tensor, motion: Tensor) -> Tensor:
    """Features (..., 6) that the change of the box's extents depends on.

    A rectangle is the same after half a turn, so only cos 2dθ and sin 2dθ matter. The box's
    extents fix the rectangle's yaw up to sign; where the object lies in the box tells the sign,
    and mirroring the scene changes the sign of sin 2dθ and of the object's u v together, so only
    their product enters. The features are cos 2dθ, width, depth, u v sin 2dθ, u² and v², with
    (u, v) the object's place relative to the box's centre.
    """
    u, v = parts[..., 4] - parts[..., 0], parts[..., 5] - parts[..., 1]
    turn = 2 * motion[..., 2]
    columns = turn.cos(), parts[..., 2], parts[..., 3], u * v * turn.sin(), u * u, v * v
    return torch.stack(torch.broadcast_tensors(*columns), dim=-1)
