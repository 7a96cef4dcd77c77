"""Solids that links collide as: sums of a box, a disc and a ball, which are cylinders exactly."""

from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.errors import RobotError


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

    def capsules(self) -> tuple[Tensor, Tensor]:
        """Both ends of axes (2S, 3) and radii (2S,) of capsules around the solids, m."""
        half, rows = self.size[:, :3], torch.arange(len(self))
        long = half.argmax(1)
        along = self.pose[rows, :, long] * half[rows, long, None]
        radius = half.scatter(1, long[:, None], 0.0).norm(dim=1) + self.size[:, 3:].sum(1)
        middle = self.pose[..., 3]
        return torch.cat([middle - along, middle + along]), radius.repeat(2)

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
    if not shapes:
        return fixed_solids(torch.empty(0, 3, 4).double(), torch.empty(0, 5).double())
    poses, sizes, frames, joints = zip(*shapes, strict=True)
    pose, size = torch.stack(poses)[:, :3], torch.stack(sizes)
    return Solids(pose, size, torch.tensor(frames), torch.tensor(joints))


def fixed_solids(pose: Tensor, size: Tensor) -> Solids:
    """Solids with poses (S, 3, 4) in the base frame and sizes (S, 5)."""
    still = torch.full((len(size),), -1)
    return Solids(pose, size, still, torch.zeros_like(still))


def solid_of(collision: Any, where: str) -> tuple[Tensor, Tensor]:
    """Pose (4, 4) and size (5,) of a URDF collision element.

    RobotError if the element, called `where`, is a mesh or has an impossible size.
    """
    kind, sizes = _shape_of(collision, where)
    if kind == "sphere":
        size = [0.0, 0.0, 0.0, 0.0, sizes[0]]
    elif kind == "cylinder":
        size = [0.0, 0.0, sizes[1] / 2, sizes[0], 0.0]
    else:
        size = [*(side / 2 for side in sizes), 0.0, 0.0]
    origin = torch.eye(4).tolist() if collision.origin is None else collision.origin
    return torch.as_tensor(origin, dtype=torch.float64), torch.tensor(size, dtype=torch.float64)


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


def _shape_of(collision: Any, where: str) -> tuple[str, list[float]]:
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
    if min(sizes) < 0 or (kind == "box" and min(sizes) == 0):
        raise RobotError(f"{where} collides as a shape of size {min(sizes)} m: give it some size")
    return kind, [float(size) for size in sizes]
