"""Planar geometry of the tabletop: frames and boxes.

A pose is (x, y, θ) in m and rad. A rectangle is (centre x, centre y, yaw, size x, size y).
"""

import math

import torch
from torch import Tensor


def wrap(angle: Tensor) -> Tensor:
    """The same angles within [-π, π)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def rotate(point: Tensor, angle: Tensor) -> Tensor:
    """Points (..., 2) turned by angles (...) about the origin."""
    c, s = torch.cos(angle), torch.sin(angle)
    x, y = point.unbind(-1)
    return torch.stack([c * x - s * y, s * x + c * y], -1)


def to_frame(pose: Tensor, point: Tensor) -> Tensor:
    """Points (..., 2) of the world as seen from poses (..., 3)."""
    return rotate(point - pose[..., :2], -pose[..., 2])


def moved(pose: Tensor, motion: Tensor) -> Tensor:
    """Poses (..., 3) after motions (..., 3) given in the robot's own frame: drive, then turn."""
    xy = pose[..., :2] + rotate(motion[..., :2], pose[..., 2])
    return torch.cat([xy, wrap(pose[..., 2:] + motion[..., 2:])], -1)


def rectangle_in_frame(pose: Tensor, rectangle: Tensor) -> Tensor:
    """Rectangles (..., 5) of the world as seen from poses (..., 3)."""
    centre = to_frame(pose, rectangle[..., :2])
    yaw = wrap(rectangle[..., 2] - pose[..., 2])
    return torch.cat([centre, yaw[..., None], rectangle[..., 3:5]], -1)


def bounding_box(rectangle: Tensor) -> Tensor:
    """Axis-aligned boxes (..., 4) x min, x max, y min, y max of turned rectangles (..., 5)."""
    x, y, yaw, sx, sy = rectangle.unbind(-1)
    c, s = torch.cos(yaw).abs(), torch.sin(yaw).abs()
    hx, hy = (c * sx + s * sy) / 2, (s * sx + c * sy) / 2
    return torch.stack([x - hx, x + hx, y - hy, y + hy], -1)


def box_rectangle(box: Tensor) -> Tensor:
    """Axis-aligned boxes (..., 4) as rectangles (..., 5) of yaw 0."""
    x0, x1, y0, y1 = box.unbind(-1)
    columns = (x0 + x1) / 2, (y0 + y1) / 2, torch.zeros_like(x0), x1 - x0, y1 - y0
    return torch.stack(columns).movedim(0, -1)


def corners(rectangle: Tensor) -> Tensor:
    """(..., 4, 2) corners of rectangles (..., 5)."""
    signs = rectangle.new_tensor([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    offset = signs * rectangle[..., None, 3:5] / 2
    return rectangle[..., None, :2] + rotate(offset, rectangle[..., None, 2])


def polygons_overlap(a: Tensor, b: Tensor, axes: Tensor) -> Tensor:
    """(...) bool, whether convex polygons share a point, by the separating-axis test.

    Their corners are (..., A, 2) and (..., B, 2), `axes` (..., K, 2) the normals of all edges of
    both; a zero axis separates nothing.
    """
    pa, pb = a @ axes.mT, b @ axes.mT
    apart = (pa.amax(-2) < pb.amin(-2)) | (pb.amax(-2) < pa.amin(-2))
    return ~apart.any(-1)
