"""From the steps of an execution to pictures in time: the positions of base, arms and object."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from cgtorch.graphs import Action
from cgtorch.tabletop.actions import Detect, Grasp
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


UPRIGHT = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
"""The quaternion of an object that stands, w first."""


@dataclass(frozen=True)
class Moves:
    """F pictures, one at least, of a step; see `Timeline`."""

    pose: Tensor
    joints: Tensor
    object: Tensor
    turned: Tensor
    contacts: tuple[Tensor, ...]

    @classmethod
    def joined(cls, parts: Sequence["Moves"]) -> "Moves":
        """One after the other."""
        pose, joints, thing, turned = (
            torch.cat([getattr(part, name) for part in parts])
            for name in ("pose", "joints", "object", "turned")
        )
        points = tuple(points for part in parts for points in part.contacts)
        return cls(pose, joints, thing, turned, points)

    def __len__(self) -> int:
        """F."""
        return len(self.pose)

    @property
    def last(self) -> "Moves":
        """The last picture, without its contacts."""
        return Moves(self.pose[-1:], self.joints[-1:], self.object[-1:], self.turned[-1:], ())

    def lasting(self, seconds: float) -> "Moves":
        """The last picture for so long."""
        count = _count(seconds)
        rows = self.pose, self.joints, self.object, self.turned
        pose, joints, thing, turned = (row[-1:].expand(count, -1) for row in rows)
        none = torch.zeros(0, 4, dtype=torch.float64)
        return Moves(pose, joints, thing, turned, (none,) * count)


@dataclass(frozen=True)
class Timeline:
    """F pictures of an execution, `FPS` per second.

    Attributes:
        names: J joints, those of all arms first, one arm after the other.
        pose: (F, 3) base x, y (m), θ (rad).
        joints: (F, J) positions of the joints, rad or m.
        object: (F, 3) where the object stands or is held, its foot, m.
        turned: (F, 4) its quaternion, w first.
        contacts: F times (C, 4): points (m) where the robot presses on something, and 1 where it
            should not, else 0.
        step: (F,) long, the present step.
        seen: (F,) long, the number of steps before the present percept.
    """

    execution: Execution
    names: tuple[str, ...]
    pose: Tensor
    joints: Tensor
    object: Tensor
    turned: Tensor
    contacts: tuple[Tensor, ...]
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
    """The joints of all arms, one arm after the other."""
    return tuple(name for arm in robot.arms for name in arm.joint_names)


def timeline_of(execution: Execution, robot: Robot) -> Timeline:
    """The pictures of an execution; the base drives straight and then turns, as in the world.

    If a grasp succeeds, an arm follows its way from home to the pre-grasp, grasps and lifts the
    object (`cgtorch.tabletop.kinematics.arm_ways`).
    """
    scene = execution.scenario
    joints = torch.cat(robot.home).double()[None]
    thing = torch.cat([scene.object[0], scene.table[0, 5:6]]).double()[None]
    pieces = []
    for k, step in enumerate(execution.steps):
        before, after = execution.pose[k].double(), execution.pose[k + 1].double()
        there = execution.object[k + 1 : k + 2].double()
        grasped = isinstance(step.action, Grasp) and step.outcome == "success"
        pose = _drive(before, after)
        if grasped:
            joints, thing = _grasp(execution, k, robot, joints[-1], thing[-1])
        elif len(pose) == 1:
            pose = pose.expand(_count(seconds_of(step.action)), 3)
        pieces.append(_together(pose, joints, thing))
        joints, thing = joints[-1:], thing[-1:] if grasped else there
    return laid_out(execution, joint_names(robot), pieces)


def laid_out(execution: Execution, names: tuple[str, ...], pieces: Sequence[Moves]) -> Timeline:
    """The pictures of all steps one after the other, and the last one for a while."""
    rest = pieces[-1].lasting(REST)
    every, steps = Moves.joined([*pieces, rest]), len(pieces)
    which = [torch.full((len(moves),), k) for k, moves in enumerate(pieces)]
    seen = [torch.cat([rows[1:], rows[:1] + 1]) for rows in which]
    which.append(torch.full((len(rest),), max(0, steps - 1)))
    seen.append(torch.full((len(rest),), steps))
    rows = every.pose.float(), every.joints.float(), every.object.float(), every.turned.float()
    return Timeline(execution, names, *rows, every.contacts, torch.cat(which), torch.cat(seen))


def seconds_of(action: Action) -> float:
    """How long a step of an action lasts that moves nothing (s)."""
    return LOOK if isinstance(action, Detect | Grasp) else THINK


def _together(*rows: Tensor) -> Moves:
    """Poses, joints and objects of a step, each with its last row again until all are as long."""
    count = max(map(len, rows))
    pose, joints, thing = (_held(each, count) for each in rows)
    none = torch.zeros(0, 4, dtype=torch.float64)
    return Moves(pose, joints, thing, UPRIGHT.expand(count, 4), (none,) * count)


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
