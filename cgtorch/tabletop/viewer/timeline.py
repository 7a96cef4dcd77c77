"""From the steps of an execution to pictures in time: the positions of base, arms and object."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from cgtorch.actions import Detect, Grasp
from cgtorch.tabletop.kinematics import Robot, arm_ways
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT
from cgtorch.tabletop.viewer.execution import Execution
from cgtorch.tabletop.world.geometry import rectangle_in_frame, to_frame, wrap

FPS = 20
DRIVE, TURN, SWING = 0.6, 1.2, 1.2
"""Speeds of the base (m/s, rad/s) and of an arm's fastest joint (rad/s)."""
NEAR = 0.05
"""The least time (s) of a hand between two waypoints of its line to the object and up."""
THINK, LOOK, REST = 0.4, 0.8, 1.0
"""Durations (s) of a step without motion, of one that perceives, and of the end."""


@dataclass(frozen=True)
class Timeline:
    """F pictures of an execution, `FPS` per second.

    Attributes:
        pose: (F, 3) base x, y (m), θ (rad).
        joints: (F, J) positions of the joints of all arms, one arm after the other, rad or m.
        object: (F, 3) where the object is, m.
        step: (F,) long, the present step.
        seen: (F,) long, the number of steps before the present percept.
    """

    execution: Execution
    pose: Tensor
    joints: Tensor
    object: Tensor
    step: Tensor
    seen: Tensor

    def __len__(self) -> int:
        """F."""
        return len(self.step)

    def start_of(self, step: int) -> int:
        """The first picture of a step; the last picture of all if there is no such step."""
        at = (self.step >= step).nonzero()
        return int(at[0]) if len(at) else len(self) - 1


def joint_names(robot: Robot) -> tuple[str, ...]:
    """The joints of the columns of `Timeline.joints`."""
    return tuple(name for arm in robot.arms for name in arm.joint_names)


def timeline_of(execution: Execution, robot: Robot) -> Timeline:
    """The pictures of an execution; the base drives straight and then turns, as in the world.

    If a grasp succeeds, an arm follows its way from home to the pre-grasp, grasps and lifts the
    object (`cgtorch.tabletop.kinematics.arm_ways`).
    """
    scene = execution.scenario
    joints = torch.cat(robot.home).double()[None]
    thing = torch.cat([scene.object[0], scene.table[0, 5:6]]).double()[None]
    pieces: list[list[Tensor]] = []
    for k, step in enumerate(execution.steps):
        before, after = execution.pose[k].double(), execution.pose[k + 1].double()
        there = execution.object[k + 1 : k + 2].double()
        pose = _drive(before, after)
        if isinstance(step.action, Grasp) and step.outcome == "success":
            joints, thing = _grasp(execution, k, robot, joints[-1], thing[-1])
        elif len(pose) == 1:
            looks = isinstance(step.action, Detect | Grasp)
            pose = pose.expand(_count(LOOK if looks else THINK), 3)
        count = max(len(pose), len(joints))
        seen = torch.full((count,), k)
        seen[-1] = k + 1
        moving = [_held(rows, count) for rows in (pose, joints, thing)]
        pieces.append([*moving, torch.full((count,), k), seen])
        grasped = isinstance(step.action, Grasp) and step.outcome == "success"
        joints, thing = joints[-1:], thing[-1:] if grasped else there
    last, count = len(execution.steps), _count(REST)
    still = [_held(rows, count) for rows in (execution.pose[-1:].double(), joints, thing)]
    pieces.append([*still, torch.full((count,), max(0, last - 1)), torch.full((count,), last)])
    pose, joints, thing, which, seen = (torch.cat(rows) for rows in zip(*pieces, strict=True))
    return Timeline(execution, pose.float(), joints.float(), thing.float(), which, seen)


def _count(seconds: float) -> int:
    return max(1, round(seconds * FPS))


def _held(rows: Tensor, count: int) -> Tensor:
    """The rows, with the last one repeated until there are `count`."""
    return torch.cat([rows, rows[-1:].expand(count - len(rows), -1)])


def _line(start: Tensor, end: Tensor, seconds: float) -> Tensor:
    """(F, n) points on the straight line, with its end and without its start."""
    count = _count(seconds)
    return start + torch.arange(1, count + 1, dtype=start.dtype)[:, None] / count * (end - start)


def _drive(before: Tensor, after: Tensor) -> Tensor:
    """(F, 3) poses from one to another: straight, then turning; a single one without motion."""
    way, turn = float((after - before)[:2].norm()), wrap(after[2:] - before[2:])
    if way == 0 and float(turn) == 0:
        return after[None]
    corner = torch.cat([after[:2], before[2:]])
    driven = _line(before, corner, way / DRIVE)
    return torch.cat([driven, _line(corner, torch.cat([after[:2], before[2:] + turn]),
                                    float(turn.abs()) / TURN)])  # fmt: skip


def _grasp(
    execution: Execution, k: int, robot: Robot, joints: Tensor, thing: Tensor
) -> tuple[Tensor, Tensor]:
    """Joints (F, J) and objects (F, 3) while the object is grasped and lifted, from step k on."""
    pose, scene = execution.pose[k : k + 1], execution.scenario
    at = torch.cat([to_frame(pose, scene.object), scene.table[:, 5:6]], 1)
    table = torch.cat([rectangle_in_frame(pose, scene.table[:, :5]), scene.table[:, 5:6]], 1)
    ways = arm_ways(robot, at, table)
    if not ways.found[0]:
        return joints[None], thing[None]
    which, pre_grasp = int(ways.arm[0]), int(ways.pre_grasp[0])
    arm = robot.arms[which]
    first, count = sum(len(a.joint_names) for a in robot.arms[:which]), len(arm.joint_names)
    way = ways.joints[0, : int(ways.lifted[0]) + 1, :count].double()
    moving = [way[:1]]
    for i, (here, goal) in enumerate(pairwise(way)):
        seconds = float((goal - here).abs().max()) / SWING
        moving.append(_line(here, goal, seconds if i < pre_grasp else max(seconds, NEAR)))
    path = torch.cat(moving)
    grasped = sum(len(part) for part in moving[: int(ways.grasp[0]) + 1])
    all_joints = joints.expand(len(path), -1).clone()
    all_joints[:, first : first + count] = path
    things = thing.expand(len(path), 3).clone()
    things[grasped:, 2] = arm.frames(path[grasped:])[-1][:, 2, 3] - GRASP_HEIGHT
    return all_joints, things
