"""Collision shapes of links: capsules, oriented boxes, and solids, which have exact cylinders."""

import math
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.errors import RobotError

MAX_FLATNESS = 500  # of a box: beyond it would be too many capsules


class Tensors:
    """A base for dataclasses with tensor fields, which move and are indexed together."""

    def to(self, like: Tensor) -> Self:
        """The same on the device of a tensor, with floating-point fields in its dtype."""
        moved = {
            name: x.to(like) if x.is_floating_point() else x.to(like.device)
            for name, x in vars(self).items()
            if isinstance(x, Tensor)
        }
        return type(self)(**{**vars(self), **moved})

    def __getitem__(self, rows: Tensor | slice | None) -> Self:
        """Some rows of all fields, or with None all as one row."""
        return type(self)(*(each[rows] for each in vars(self).values()))


@dataclass(frozen=True)
class Boxes(Tensors):
    """Oriented boxes: centres (..., N, 3), axes as columns (..., N, 3, 3), half sizes, m."""

    centre: Tensor
    rotation: Tensor
    half: Tensor


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


@dataclass(frozen=True)
class Solids(Tensors):
    """Sums of a box, a disc and a ball, in the frames of an arm, or in the base frame.

    Attributes:
        pose: (S, 3, 4) upper rows of the pose of each in its frame.
        size: (S, 5) half sides of the box, radius of the disc about z, radius of the ball, m. A
            cylinder is half its height and a disc; a capsule is half the length of its axis and a
            ball.
        frame: (S,) long, the frame of the arm's chain with which each moves, or -1.
        joints: (S,) long, the number of the arm's joints that move it.
    """

    pose: Tensor
    size: Tensor
    frame: Tensor
    joints: Tensor

    def __len__(self) -> int:
        """S."""
        return len(self.size)

    @property
    def radius(self) -> Tensor:
        """(S,) radius of the bounding ball about each solid's centre, m."""
        x, y, z, disc, ball = self.size.unbind(-1)
        return (x.hypot(y) + disc).hypot(z) + ball

    def placed(self, frames: Tensor) -> "Solids":
        """The solids in the base frame, for frames of the chain with poses (F, 4, 4)."""
        pose = frames[self.frame, :3, :3] @ self.pose
        pose[..., 3] += frames[self.frame, :3, 3]
        return fixed_solids(pose, self.size)

    def joined(self, *more: "Solids") -> "Solids":
        """All of them, one after the other."""
        every = (self, *more)
        return Solids(*(torch.cat([getattr(s, name) for s in every]) for name in vars(self)))


def with_boxed_hand(solids: Solids, joints: int) -> Solids:
    """Solids of an arm, with those that all its joints move replaced by one box around them."""
    hand = solids.joints == joints
    if int(hand.sum()) < 2:
        return solids
    pose, size = solids.pose[hand], solids.size[hand]
    half = size[:, :3] + size[:, 4:] + size[:, 3:4] * size.new_tensor([1.0, 1.0, 0.0])
    spread = (pose[..., :3].abs() @ half[..., None]).squeeze(-1)
    low, high = (pose[..., 3] - spread).amin(0), (pose[..., 3] + spread).amax(0)
    box = torch.cat([torch.eye(3).to(low), ((low + high) / 2)[:, None]], 1)
    last = int(solids.frame[hand].max())
    sides = pad((high - low) / 2, (0, 2))
    whole = Solids(box[None], sides[None], torch.tensor([last]), torch.tensor([joints]))
    return solids[~hand].joined(whole)


def solids_of(shapes: list[tuple[Tensor, Tensor, int, int]]) -> Solids:
    """Solids from pose (4, 4), size (5,), frame and number of joints of each."""
    return Solids(
        pose=stacked([pose[:3] for pose, *_ in shapes], 3, 4),
        size=stacked([size for _, size, *_ in shapes], 5),
        frame=torch.tensor([frame for *_, frame, _ in shapes], dtype=torch.long),
        joints=torch.tensor([joints for *_, joints in shapes], dtype=torch.long),
    )


def stacked(tensors: list[Tensor], *shape: int) -> Tensor:
    """Tensors of a shape as one (k, *shape), also for k = 0."""
    return torch.stack(tensors) if tensors else torch.zeros(0, *shape, dtype=torch.float64)


def fixed_solids(pose: Tensor, size: Tensor) -> Solids:
    """Solids with poses (S, 3, 4) in the base frame and sizes (S, 5)."""
    still = torch.full((len(size),), -1)
    return Solids(pose, size, still, torch.zeros_like(still))


def boxes_as_solids(boxes: Boxes) -> Solids:
    """Fixed boxes (N, ...) as solids."""
    pose = torch.cat([boxes.rotation, boxes.centre[..., None]], -1)
    return fixed_solids(pose, pad(boxes.half, (0, 2)))


def solid_of(collision: Any, where: str) -> tuple[Tensor, Tensor]:
    """Pose (4, 4) and size (5,) of a URDF collision element; for errors see `capsules_of`."""
    kind, sizes = shape_of(collision, where)
    if kind == "sphere":
        size = [0.0, 0.0, 0.0, 0.0, sizes[0]]
    elif kind == "cylinder":
        size = [0.0, 0.0, sizes[1] / 2, sizes[0], 0.0]
    else:
        size = [*(side / 2 for side in sizes), 0.0, 0.0]
    return pose_of(collision), torch.tensor(size, dtype=torch.float64)


def solid_of_capsule(start: Tensor, end: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Pose (4, 4) and size (5,) of a capsule from `start` to `end` (3,), m."""
    along = end - start
    length = along.norm()
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = (start + end) / 2
    if length > 0:
        z = along / length
        x = torch.eye(3, dtype=torch.float64)[int(z.abs().argmin())]
        y = torch.linalg.cross(z, x)
        y = y / y.norm()
        pose[:3, :3] = torch.stack([torch.linalg.cross(y, z), y, z], 1)
    return pose, torch.tensor([0.0, 0.0, length / 2, 0.0, radius], dtype=torch.float64)


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
