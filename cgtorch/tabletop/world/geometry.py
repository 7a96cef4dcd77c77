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
    return torch.cat([centre, yaw[..., None], rectangle[..., 3:]], -1)


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
    offset = signs * rectangle[..., None, 3:] / 2
    return rectangle[..., None, :2] + rotate(offset, rectangle[..., None, 2])


def rectangles_overlap(first: Tensor, second: Tensor) -> Tensor:
    """(B,) bool, whether rectangles (B, 5) overlap, by separating axes; touching does not count."""
    between = second[:, :2] - first[:, :2]
    axes = torch.cat([_axes(first[:, 2]), _axes(second[:, 2])], dim=1)
    gap = (axes * between[:, None]).sum(-1).abs()
    reach = sum(
        ((axes[:, :, None] * _axes(r[:, 2])[:, None]).sum(-1).abs() * r[:, None, 3:] / 2).sum(-1)
        for r in (first, second)
    )
    return (gap < reach).all(dim=1)


def _axes(yaw: Tensor) -> Tensor:
    """(B, 2, 2): the two axes of turned rectangles, as rows."""
    cos, sin = yaw.cos(), yaw.sin()
    return torch.stack([torch.stack([cos, sin], -1), torch.stack([-sin, cos], -1)], dim=1)
