"""Whether a robot could grasp an object from some place around it, however it gets there."""

import math
from collections.abc import Callable

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.geometry import (
    box_rectangle,
    rectangle_in_frame,
    rectangles_overlap,
    to_frame,
)
from cgtorch.tabletop.world.percepts import present

NEAREST, FARTHEST = 0.35, 1.15  # m from the object to the middle of the base
DISTANCES, DIRECTIONS, HEADINGS = 9, 16, 5
TURNED = math.pi / 3  # rad, the largest angle between the heading and the object
FIRST = 24  # places that are tried first, as a fifth of them is good in most scenarios

Grasps = Callable[[Tensor, Tensor], Tensor]
"""Maps objects (n, 3) and tables (n, 6) in the robot's frame to (n,) bool."""


def places() -> Tensor:
    """(n, 3) poses around an object that lies at the origin: x, y (m), θ (rad), in random order."""
    distance = torch.linspace(NEAREST, FARTHEST, DISTANCES)
    direction = torch.arange(DIRECTIONS) * math.tau / DIRECTIONS
    turn = torch.linspace(-TURNED, TURNED, HEADINGS)
    r, a, t = (each.flatten() for each in torch.meshgrid(distance, direction, turn, indexing="ij"))
    poses = torch.stack([r * a.cos(), r * a.sin(), a + math.pi + t], 1)
    return poses[torch.randperm(len(poses), generator=Generator().manual_seed(0))]


def graspable_from_somewhere(
    scenarios: Scenarios, footprint: tuple[float, float, float, float], grasps: Grasps
) -> Tensor:
    """(B,) bool, whether the object can be grasped from one of `places` where the base can stand.

    The base's footprint is x min, x max, y min, y max, m.
    """
    found, every = torch.zeros(len(scenarios), dtype=torch.bool), places()
    for some in (every[:FIRST], every[FIRST:]):
        for row in (~found).nonzero()[:, 0].tolist():
            found[row] = _from_one_of(some, scenarios[row : row + 1], footprint, grasps)
    return found


def _from_one_of(
    poses: Tensor, scene: Scenarios, footprint: tuple[float, float, float, float], grasps: Grasps
) -> bool:
    """Whether the object of one scenario can be grasped from one of the poses (n, 3) around it."""
    pose = torch.cat([poses[:, :2] + scene.object, poses[:, 2:]], 1)
    base = box_rectangle(pose.new_tensor(footprint)).expand(len(pose), 5)
    there = scene.obstacles[0][present(scene.obstacles[0])]
    boxes = [scene.table[:, :5], *(box[None] for box in there)]
    seen = [rectangle_in_frame(pose, box.expand(len(pose), 5)) for box in boxes]
    clear = ~torch.stack([rectangles_overlap(base, box) for box in seen]).any(0)
    height = scene.table[:, 5:].expand(len(pose), 1)
    at = torch.cat([to_frame(pose, scene.object.expand(len(pose), 2)), height], 1)
    return bool(grasps(at[clear], torch.cat([seen[0], height], 1)[clear]).any())
