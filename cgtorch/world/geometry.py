"""Planar geometry of the tabletop: frames, boxes, and what a driving footprint sweeps over.

A pose is (x, y, θ) in m and rad. A rectangle is (centre x, centre y, yaw, size x, size y). A
footprint is (x min, x max, y min, y max) in the robot base frame.
"""

import math

import torch
from torch import Tensor

TURN_STEP = math.radians(15)  # a corner of the PR2 protrudes 4 mm between two such steps


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
    return torch.stack([(x0 + x1) / 2, (y0 + y1) / 2, torch.zeros_like(x0), x1 - x0, y1 - y0], -1)


def corners(rectangle: Tensor) -> Tensor:
    """(..., 4, 2) corners of rectangles (..., 5)."""
    signs = rectangle.new_tensor([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    offset = signs * rectangle[..., None, 3:5] / 2
    return rectangle[..., None, :2] + rotate(offset, rectangle[..., None, 2])


def polygons_overlap(a: Tensor, b: Tensor, axes: Tensor) -> Tensor:
    """Separating-axis test of convex polygons.

    Args:
        a: (..., A, 2) corners.
        b: (..., B, 2) corners.
        axes: (..., K, 2) normals of all edges of both; a zero axis separates nothing.

    Returns:
        (...) bool, whether they share a point.
    """
    pa, pb = a @ axes.mT, b @ axes.mT
    apart = (pa.amax(-2) < pb.amin(-2)) | (pb.amax(-2) < pa.amin(-2))
    return ~apart.any(-1)


def _footprint_corners(footprint: Tensor, clearance: float) -> Tensor:
    x0, x1, y0, y1 = (footprint + footprint.new_tensor([-1, 1, -1, 1]) * clearance).unbind(-1)
    return torch.stack(
        [torch.stack([x, y], -1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], -2
    )


def sweep_blocked(
    motion: Tensor, rectangle: Tensor, footprint: Tensor, clearance: float = 0.0
) -> Tensor:
    """Whether a footprint that drives straight and then turns would touch a rectangle.

    Args:
        motion: (n, 3) dx, dy (m), dθ (rad), in the frame of the robot before it moves.
        rectangle: (n, 5) the obstacle in the same frame.
        footprint: (4,) the robot seen from above.
        clearance: m, added to the footprint on every side.

    Returns:
        (n,) bool. A motion that is not finite counts as blocked.
    """
    body = _footprint_corners(footprint, clearance).expand(len(motion), 4, 2)
    table = corners(rectangle)
    end = body + motion[:, None, :2]
    unit = torch.eye(2, dtype=motion.dtype, device=motion.device).expand(len(motion), 2, 2)
    direction = motion[:, None, [1, 0]] * motion.new_tensor([-1, 1])
    sides = table[:, 1:3] - table[:, 0:2]
    blocked = polygons_overlap(
        torch.cat([body, end], 1), table, torch.cat([unit, direction, sides], 1)
    )
    return blocked | _turn_blocked(motion, table, body, sides) | ~motion.isfinite().all(1)


def _turn_blocked(motion: Tensor, table: Tensor, body: Tensor, sides: Tensor) -> Tensor:
    """(n,) bool; only lanes whose turning circle touches the obstacle are looked at closely."""
    blocked = torch.zeros(len(motion), dtype=torch.bool, device=motion.device)
    pivot = motion[:, :2]
    # Distance from the pivot to the rectangle, in the rectangle's own frame.
    size = sides.norm(dim=-1)
    axes = sides / size[..., None].clamp_min(1e-12)
    local = ((pivot - table.mean(1))[:, None] * axes).sum(-1).abs()
    gap = (local - size / 2).clamp_min(0).norm(dim=-1)
    radius = body[0].norm(dim=-1).amax() if len(body) else 0.0
    near = ((gap < radius) & (motion[:, 2] != 0)).nonzero()[:, 0]
    if not len(near):
        return blocked
    steps = math.ceil(math.pi / TURN_STEP)
    angle = wrap(motion[near, 2:]) * torch.linspace(
        1 / steps, 1, steps, dtype=motion.dtype, device=motion.device
    )
    turned = rotate(body[near, None], angle[..., None]) + pivot[near, None, None]
    normals = turned[:, :, 1:3] - turned[:, :, 0:2]
    fixed = sides[near, None].expand_as(normals)
    other = table[near, None].expand_as(turned)
    hit = polygons_overlap(turned, other, torch.cat([normals, fixed], 2))
    blocked[near] = hit.any(1)
    return blocked
