"""Solids: each is the sum of a box, a disc and a ball, which represents cylinders exactly."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.collision import Boxes, Tensors, pose_of, shape_of


@dataclass(frozen=True)
class Solids(Tensors):
    """Solids in the frames of an arm, or in the base frame.

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
        return ball_radius(self.size)

    def placed(self, frames: Tensor) -> "Solids":
        """The solids in the base frame, for frames of the chain with poses (F, 4, 4)."""
        pose = frames[self.frame, :3, :3] @ self.pose
        pose[..., 3] += frames[self.frame, :3, 3]
        still = torch.full_like(self.frame, -1)
        return Solids(pose, self.size, still, torch.zeros_like(still))

    def joined(self, *more: "Solids") -> "Solids":
        """All of them, one after the other."""
        every = (self, *more)
        return Solids(*(torch.cat([getattr(s, name) for s in every]) for name in vars(self)))


def ball_radius(size: Tensor) -> Tensor:
    """(...) radius of the bounding ball about the centre of solids of sizes (..., 5), m."""
    x, y, z, disc, ball = size.unbind(-1)
    return (x.hypot(y) + disc).hypot(z) + ball


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
    sides = torch.nn.functional.pad((high - low) / 2, (0, 2))
    last = int(solids.frame[hand].max())
    whole = Solids(box[None], sides[None], torch.tensor([last]), torch.tensor([joints]))
    arm = Solids(*(each[~hand] for each in vars(solids).values()))
    return arm.joined(whole)


def solids_of(shapes: list[tuple[Tensor, Tensor, int, int]]) -> Solids:
    """Solids from pose (4, 4), size (5,), frame and number of joints of each."""
    poses = [pose[:3] for pose, *_ in shapes]
    return Solids(
        pose=torch.stack(poses) if shapes else torch.zeros(0, 3, 4, dtype=torch.float64),
        size=torch.stack([s[1] for s in shapes]) if shapes else torch.zeros(0, 5).double(),
        frame=torch.tensor([s[2] for s in shapes], dtype=torch.long),
        joints=torch.tensor([s[3] for s in shapes], dtype=torch.long),
    )


def boxes_as_solids(boxes: Boxes) -> Solids:
    """Fixed boxes (N, ...) as solids."""
    pose = torch.cat([boxes.rotation, boxes.centre[..., None]], -1)
    still = torch.full((len(boxes.half),), -1)
    return Solids(pose, torch.nn.functional.pad(boxes.half, (0, 2)), still, torch.zeros_like(still))


def solid_of(collision: Any, where: str) -> tuple[Tensor, Tensor]:
    """Pose (4, 4) and size (5,) of a URDF collision element; for errors see `capsules_of`."""
    kind, sizes = shape_of(collision, where)
    size = torch.zeros(5, dtype=torch.float64)
    if kind == "sphere":
        size[4] = sizes[0]
    elif kind == "cylinder":
        size[2], size[3] = sizes[1] / 2, sizes[0]
    else:
        size[:3] = torch.tensor(sizes, dtype=torch.float64) / 2
    return pose_of(collision), size


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
    size = torch.zeros(5, dtype=torch.float64)
    size[2], size[4] = length / 2, radius
    return pose, size
