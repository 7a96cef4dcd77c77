"""Collision of arm links, as capsules, with oriented boxes: the table, the torso, the base."""

import ctypes
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import RobotError
from cgtorch.native import function, threads
from cgtorch.native.structures import POINTER, WHOLE, structures, suits

SHOULDER_JOINTS = 3
"""Links that hang from fewer joints than this, or as many, are held off the body by joint limits
and by being built beside it; only the table can stop them."""

BISECTIONS = 8
ROUNDING = 1e-5
WORTH_SHARING = 512
"""Postures that are worth one more thread: about a quarter of a millisecond."""
MAX_FLATNESS = 500  # of a box: beyond it would be too many capsules


@dataclass(frozen=True)
class Boxes:
    """Oriented boxes.

    Attributes:
        centre: (..., N, 3) centres, m.
        rotation: (..., N, 3, 3) the axes of each box as columns.
        half: (..., N, 3) half sizes, m.
    """

    centre: Tensor
    rotation: Tensor
    half: Tensor

    def to(self, like: Tensor) -> "Boxes":
        """The same boxes on the device and in the dtype of a tensor."""
        return Boxes(self.centre.to(like), self.rotation.to(like), self.half.to(like))


@dataclass(frozen=True)
class Capsules:
    """Capsules that move with the frames of an arm.

    Attributes:
        frame: (C,) which of the chain's frames each moves with.
        joints: (C,) how many of the arm's joints move it.
        start: (C, 3) one end of its axis in that frame, m.
        end: (C, 3) the other end, m.
        radius: (C,) its radius, m.
    """

    frame: Tensor
    joints: Tensor
    start: Tensor
    end: Tensor
    radius: Tensor

    def to(self, like: Tensor) -> "Capsules":
        """The same capsules on the device and in the dtype of a tensor."""
        return Capsules(
            self.frame.to(like.device),
            self.joints.to(like.device),
            self.start.to(like),
            self.end.to(like),
            self.radius.to(like),
        )

    def where(self, mask: Tensor) -> "Capsules":
        """Only the capsules of a (C,) mask."""
        return Capsules(
            self.frame[mask], self.joints[mask], self.start[mask], self.end[mask], self.radius[mask]
        )

    def placed(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Where the axes are when the frames have these poses.

        Args:
            frames: (F, B, 4, 4) poses of the chain's frames.

        Returns:
            (B, C, 3) starts and ends, m.
        """
        pose = frames[self.frame].transpose(0, 1)
        rotation, shift = pose[..., :3, :3], pose[..., :3, 3]
        start = (rotation @ self.start[:, :, None]).squeeze(-1) + shift
        end = (rotation @ self.end[:, :, None]).squeeze(-1) + shift
        return start, end


def collide(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor:
    """Whether any capsule of a row touches any box of that row.

    Args:
        start: (B, C, 3) one end of each capsule's axis, m.
        end: (B, C, 3) the other end, m.
        radius: (C,) radii, m.
        boxes: Boxes with N boxes per row: (B, N, ...), or the same for all: (1, N, ...).

    Returns:
        (B,) bool.
    """
    hit = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    if start.shape[1] == 0 or boxes.half.shape[-2] == 0:
        return hit
    if (found := _collide_compiled(start, end, radius, boxes)) is not None:
        return found
    return collide_in_torch(start, end, radius, boxes)


def _collide_compiled(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor | None:
    """The same, where it can be compiled."""
    call = function("collide", torch.float32, POINTER, WHOLE)
    given = [start, end, radius, boxes.centre, boxes.rotation, boxes.half]
    if call is None or start.dtype != torch.float32 or not suits(*given):
        return None
    if len(boxes.half) not in (1, len(start)):
        return None
    given = [x.contiguous() for x in given]
    hit = torch.empty(len(start), dtype=torch.bool)
    task = structures(torch.float32).Collision(
        *(x.data_ptr() for x in given), *start.shape[:2], boxes.half.shape[-2],
        len(boxes.half) == 1, BISECTIONS, ROUNDING, hit.data_ptr(),
    )  # fmt: skip
    call(ctypes.addressof(task), max(1, min(threads(), len(start) // WORTH_SHARING)))
    return hit


def collide_in_torch(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor:
    """What `collide` says, on any device."""
    hit = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    row, capsule, box = _close(start, end, radius, boxes).nonzero(as_tuple=True)
    which = row if len(boxes.half) > 1 else torch.zeros_like(row)
    to_box = boxes.rotation[which, box].transpose(-1, -2)
    centre = boxes.centre[which, box]
    a = (to_box @ (start[row, capsule] - centre)[..., None]).squeeze(-1)
    b = (to_box @ (end[row, capsule] - centre)[..., None]).squeeze(-1)
    touching = segment_box_distance(a, b, boxes.half[which, box]) < radius[capsule]
    hit[row[touching]] = True
    return hit


def _close(start: Tensor, end: Tensor, radius: Tensor, boxes: Boxes) -> Tensor:
    """(B, C, N) whether the sphere around a capsule reaches a box, which few do.

    Column by column, as rows of three numbers are too short for a processor's vectors.
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
    """Distance from segments to boxes that are centred and aligned with the axes.

    The distance is convex along a segment, so its least value is found by bisection on the slope,
    to 1/512 of the segment's length.

    Args:
        a: (..., 3) one end of each segment, m.
        b: (..., 3) the other end, m.
        half: (..., 3) half sizes of the boxes, m.

    Returns:
        (...) distances, m; 0 where the segment meets the box.
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
    return torch.stack([_outside(point, half).norm(dim=-1) for point in (a, b, closest)]).amin(
        dim=0
    )


def _outside(point: Tensor, half: Tensor) -> Tensor:
    """The vector from the nearest point of a box to a point."""
    return point - torch.maximum(torch.minimum(point, half), -half)


def rectangles_overlap(first: Tensor, second: Tensor) -> Tensor:
    """Whether two turned rectangles overlap, by separating axes; touching does not count.

    Args:
        first: (B, 5) centre x, centre y, yaw, size x, size y (m, rad).
        second: (B, 5) the same of the other rectangle.

    Returns:
        (B,) bool.
    """
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


def capsules_of(collision: Any, where: str) -> list[tuple[Tensor, Tensor, float]]:
    """A URDF collision element as capsules in the frame of its link.

    A sphere is a capsule of no length. A cylinder becomes the capsule of the same radius and
    overall length. A box that is a bar becomes one capsule along its longest side; a flatter one
    becomes parallel capsules as thick as its shortest side, laid side by side across the middle
    one. Sharp edges are thereby rounded.

    Args:
        collision: A `yourdfpy.Collision`.
        where: What to call it in an error.

    Returns:
        Capsules as (start (3,), end (3,), radius), m.

    Raises:
        RobotError: The element is a mesh.
    """
    shape = _checked(collision, where)
    local: list[tuple[list[float], list[float], float]] = []
    if shape.sphere is not None:
        local.append(([0.0] * 3, [0.0] * 3, float(shape.sphere.radius)))
    elif shape.cylinder is not None:
        radius = float(shape.cylinder.radius)
        along = max(float(shape.cylinder.length) / 2 - radius, 0.0)
        local.append(([0.0, 0.0, -along], [0.0, 0.0, along], radius))
    else:
        half = [float(size) / 2 for size in shape.box.size]
        thin, middle, long = sorted(range(3), key=lambda i: half[i])
        bar = half[middle] <= 1.5 * half[thin]
        radius = half[middle] if bar else half[thin]
        if half[middle] > MAX_FLATNESS * radius:
            raise RobotError(
                f"{where} has a box of {shape.box.size.tolist()} m, which is too flat: give it "
                "sides above 0 and some thickness"
            )
        room = half[middle] - radius
        count = 1 if bar else math.ceil(room / radius) + 1
        for i in range(count):
            start, end = [0.0] * 3, [0.0] * 3
            start[long], end[long] = radius - half[long], half[long] - radius
            start[middle] = end[middle] = 0.0 if count == 1 else room * (2 * i / (count - 1) - 1)
            local.append((start, end, radius))
    pose = _pose(collision)
    return [
        (pose[:3, :3] @ start + pose[:3, 3], pose[:3, :3] @ end + pose[:3, 3], radius)
        for start, end, radius in (
            (torch.tensor(s, dtype=torch.float64), torch.tensor(e, dtype=torch.float64), r)
            for s, e, r in local
        )
    ]


def box_of(collision: Any, where: str) -> tuple[Tensor, Tensor]:
    """A URDF collision element as the box around it, in the frame of its link.

    Args:
        collision: A `yourdfpy.Collision`.
        where: What to call it in an error.

    Returns:
        The pose (4, 4) of the box and its half sizes (3,), m.

    Raises:
        RobotError: The element is a mesh.
    """
    shape = _checked(collision, where)
    if shape.box is not None:
        half = [float(size) / 2 for size in shape.box.size]
    elif shape.sphere is not None:
        half = [float(shape.sphere.radius)] * 3
    else:
        radius = float(shape.cylinder.radius)
        half = [radius, radius, float(shape.cylinder.length) / 2]
    return _pose(collision), torch.tensor(half, dtype=torch.float64)


def _pose(collision: Any) -> Tensor:
    if collision.origin is None:
        return torch.eye(4, dtype=torch.float64)
    return torch.as_tensor(collision.origin, dtype=torch.float64)


def _checked(collision: Any, where: str) -> Any:
    """The geometry of a collision element, if it is a sphere, a cylinder or a box of some size."""
    shape = collision.geometry
    if shape.sphere is not None:
        sizes = [float(shape.sphere.radius)]
    elif shape.cylinder is not None:
        sizes = [float(shape.cylinder.radius), float(shape.cylinder.length)]
    elif shape.box is not None:
        sizes = [float(size) for size in shape.box.size]
    else:
        raise RobotError(
            f"{where} collides as a mesh, which is not read: give boxes, cylinders or spheres in "
            "the URDF, or its capsules in the robot description"
        )
    if min(sizes) < 0:
        raise RobotError(f"{where} collides as a shape of size {min(sizes)} m: give it some size")
    return shape
