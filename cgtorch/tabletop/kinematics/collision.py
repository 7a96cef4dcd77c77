"""Collision of arm links, as capsules, with oriented boxes: the table, the torso, the base."""

import math
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.ground.errors import RobotError

BISECTIONS = 8
ROUNDING = 1e-5
MAX_FLATNESS = 500  # of a box: beyond it would be too many capsules


class Tensors:
    """A base for dataclasses with tensor fields, which can move to a device together."""

    def to(self, like: Tensor) -> Self:
        """The same on the device of a tensor, with floating-point fields in its dtype."""
        moved = {
            name: x.to(like) if x.is_floating_point() else x.to(like.device)
            for name, x in vars(self).items()
            if isinstance(x, Tensor)
        }
        return type(self)(**{**vars(self), **moved})


@dataclass(frozen=True)
class Boxes(Tensors):
    """Oriented boxes: centres (..., N, 3), axes as columns (..., N, 3, 3), half sizes, m."""

    centre: Tensor
    rotation: Tensor
    half: Tensor

    def __getitem__(self, rows: Tensor | slice | None) -> "Boxes":
        """Some rows of the boxes, or with None all as one row."""
        return Boxes(self.centre[rows], self.rotation[rows], self.half[rows])


@dataclass(frozen=True)
class Capsules(Tensors):
    """Capsules that move with the frames of an arm.

    Attributes:
        frame: (C,) the frame of the chain with which each moves.
        joints: (C,) the number of the arm's joints that move it.
        start, end: (C, 3) the ends of its axis in that frame, m.
        radius: (C,) in m.
    """

    frame: Tensor
    joints: Tensor
    start: Tensor
    end: Tensor
    radius: Tensor

    def placed(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Starts and ends (B, C, 3) of the axes for frames with poses (F, B, 4, 4), m."""
        pose = frames[self.frame].transpose(0, 1)
        rotation, shift = pose[..., :3, :3], pose[..., :3, 3]
        start, end = (rotation @ point[:, :, None] for point in (self.start, self.end))
        return start.squeeze(-1) + shift, end.squeeze(-1) + shift


def collide(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor:
    """(B,) bool, whether capsules, ends (B, C, 3), radius (C,), m, meet boxes (B or 1, N, ...)."""
    hit = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    row, capsule, box = _close(start, end, radius, boxes).nonzero(as_tuple=True)
    which = row if len(boxes.half) > 1 else torch.zeros_like(row)
    to_box, centre = boxes.rotation[which, box].transpose(-1, -2), boxes.centre[which, box]
    a, b = (
        (to_box @ (point[row, capsule] - centre)[..., None]).squeeze(-1) for point in (start, end)
    )
    touching = segment_box_distance(a, b, boxes.half[which, box]) < radius[capsule]
    hit[row[touching]] = True
    return hit


def _close(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor:
    """(B, C, N) whether the sphere around a capsule reaches a box, which is rare.

    Columns are computed one by one, as rows of three numbers are too short for vectorisation.
    """
    middle, reach = (start + end) / 2, (end - start).norm(dim=-1) / 2 + radius
    x, y, z = (middle[:, :, None, i] - boxes.centre[:, None, :, i] for i in range(3))
    away = torch.zeros_like(x)
    for i in range(3):
        axis = boxes.rotation[:, None, :, :, i]
        along = axis[..., 0] * x + axis[..., 1] * y + axis[..., 2] * z
        away = away + (along.abs() - boxes.half[:, None, :, i]).clamp_min(0).square()
    return away <= (reach * (1 + ROUNDING)).square()[:, :, None]


def segment_box_distance(a: Tensor, b: Tensor, half: Tensor) -> Tensor:
    """Distance (...) of segments (..., 3) from centred boxes (..., 3) aligned with the axes, m.

    It is convex along a segment, so bisection on the slope finds its minimum, to 1/512 of the
    segment's length; it is 0 if the segment meets the box.
    """
    along = b - a
    low = torch.zeros_like((along + half)[..., 0])
    high = torch.ones_like(low)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        outside = _outside(a + middle[..., None] * along, half)
        rising = (outside * along).sum(-1) > 0
        high = torch.where(rising, middle, high)
        low = torch.where(rising, low, middle)
    closest = a + ((low + high) / 2)[..., None] * along
    ends = [_outside(point, half).norm(dim=-1) for point in (a, b, closest)]
    return torch.stack(ends).amin(0)


def _outside(point: Tensor, half: Tensor) -> Tensor:
    """The vector from the nearest point of a box to a point."""
    return point - torch.maximum(torch.minimum(point, half), -half)


def capsules_of(collision: Any, where: str) -> list[tuple[Tensor, Tensor, float]]:
    """A URDF collision element as capsules (start (3,), end (3,), radius), m, in its link's frame.

    A cylinder becomes the capsule of the same radius and overall length. A bar-shaped box becomes
    one capsule along its longest side. A flatter box becomes parallel capsules side by side, as
    thick as its shortest side. RobotError if the element, called `where`, is a mesh or has an
    impossible size.
    """
    kind, sizes = shape_of(collision, where)
    ends, radius = [([0.0] * 3, [0.0] * 3)], sizes[0]
    if kind == "cylinder":
        along = max(sizes[1] / 2 - radius, 0.0)
        ends = [([0.0, 0.0, -along], [0.0, 0.0, along])]
    elif kind == "box":
        ends, radius = _box_capsules(sizes, where)
    pose, both = pose_of(collision), torch.tensor(ends, dtype=torch.float64)
    placed = (pose[:3, :3] @ both[..., None]).squeeze(-1) + pose[:3, 3]
    return [(start, end, radius) for start, end in placed]


def _box_capsules(sizes: list[float], where: str) -> tuple[list[Any], float]:
    """Ends of the capsules that fill a box, and their radius."""
    half = [size / 2 for size in sizes]
    thin, middle, long = sorted(range(3), key=lambda i: half[i])
    bar = half[middle] <= 1.5 * half[thin]
    radius = half[middle] if bar else half[thin]
    if half[middle] > MAX_FLATNESS * radius:
        raise RobotError(
            f"{where} has a box of {sizes} m, which is too flat: give it sides above 0 and some "
            "thickness"
        )
    room = half[middle] - radius
    gaps = 0 if bar else math.ceil(room / radius)
    ends = []
    for aside in (room * (2 * i / gaps - 1) if gaps else 0.0 for i in range(gaps + 1)):
        start, end = [0.0] * 3, [0.0] * 3
        start[long], end[long] = radius - half[long], half[long] - radius
        start[middle] = end[middle] = aside
        ends.append((start, end))
    return ends, radius


def box_of(collision: Any, where: str) -> tuple[Tensor, Tensor]:
    """Pose (4, 4) and half sizes (3,), m, of the box around an element; see `capsules_of`."""
    kind, sizes = shape_of(collision, where)
    if kind == "sphere":
        sizes = [2 * sizes[0]] * 3
    elif kind == "cylinder":
        sizes = [2 * sizes[0], 2 * sizes[0], sizes[1]]
    return pose_of(collision), torch.tensor(sizes, dtype=torch.float64) / 2


def pose_of(collision: Any) -> Tensor:
    """(4, 4) pose of a collision element in its link's frame."""
    origin = torch.eye(4).tolist() if collision.origin is None else collision.origin
    return torch.as_tensor(origin, dtype=torch.float64)


def shape_of(collision: Any, where: str) -> tuple[str, list[float]]:
    """The kind of a collision element, and its radius, its radius and length, or its sides, m."""
    shape = collision.geometry
    if shape.sphere is not None:
        kind, sizes = "sphere", [shape.sphere.radius]
    elif shape.cylinder is not None:
        kind, sizes = "cylinder", [shape.cylinder.radius, shape.cylinder.length]
    elif shape.box is not None:
        kind, sizes = "box", shape.box.size
    else:
        raise RobotError(
            f"{where} collides as a mesh, which is not read: give boxes, cylinders or spheres in "
            "the URDF, or its capsules in the robot description"
        )
    if min(sizes) < 0:
        raise RobotError(f"{where} collides as a shape of size {min(sizes)} m: give it some size")
    return kind, [float(size) for size in sizes]
