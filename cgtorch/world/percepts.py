"""What there is to perceive: the paper's seven numbers, and the boxes of obstacles after them."""

import torch
from torch import Tensor

from cgtorch.world.geometry import bounding_box, box_rectangle, rectangle_in_frame, to_frame

TABLETOP = 7
"""Numbers that table and object take: x min, x max, y min, y max, then x, y, z."""
BOX = 4
"""Numbers that each obstacle takes: x min, x max, y min, y max; all 0 where there is none."""


def percept_of(pose: Tensor, table: Tensor, placed: Tensor) -> Tensor:
    """The percept (..., 7) without noise: table box and object in the base frame (m).

    Args:
        pose: (..., 3) base pose.
        table: (..., 6) table in the world.
        placed: (..., 2) object in the world.
    """
    box = bounding_box(rectangle_in_frame(pose, table[..., :5]))
    return torch.cat([box, to_frame(pose, placed), table[..., 5:6]], -1)


def present(rectangle: Tensor) -> Tensor:
    """(...) bool, whether rectangles (..., 5) stand for something: they have a size."""
    return (rectangle[..., 3:5] > 0).all(-1)


def obstacles_seen(pose: Tensor, obstacles: Tensor) -> Tensor:
    """Boxes (..., 4K) of obstacles (..., K, 5) from poses (..., 3) (m), without noise.

    What is not there is seen as four zeros, which no box can be: one that is there has a size.
    """
    box = bounding_box(rectangle_in_frame(pose[..., None, :], obstacles))
    return (box * present(obstacles)[..., None]).flatten(-2)


def things_seen(percept: Tensor) -> Tensor:
    """(..., 1 + K, 5) table and obstacles as boxes around them, from percepts (..., 7 + 4K)."""
    boxes = torch.cat([percept[..., :BOX], percept[..., TABLETOP:]], -1)
    return box_rectangle(boxes.unflatten(-1, (-1, BOX)))
