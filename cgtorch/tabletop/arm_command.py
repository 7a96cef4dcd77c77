"""Commands for a robot's driver to grasp an object: an arm's way with times, as plain data."""

from typing import Any

import numpy
import torch
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot, arm_ways
from cgtorch.tabletop.physics.bodies import GRIP, SPEED, closed_at, gripper_joints, limit_of
from cgtorch.tabletop.physics.grasp import CLOSING, TICK, legs, way_of
from cgtorch.tabletop.world.percepts import parts_of

EVERY = 5
"""Simulation ticks between two rows of a command: 50 ms."""


def arm_command(robot: Robot, percept: Tensor) -> dict[str, Any] | None:
    """The fields of an exported state machine's `ArmCommand` for a percept (D,), or None.

    They are the names of arm and joints, times (s), positions at these times (rad or m), and those
    of the gripper's joints. The way begins with the arms at home. Everything is planned for the
    table as it is seen, so use percepts with the table's side (yaw) if it may be turned.

    Raises:
        DataError: D is no length of a percept of the tabletop.
        RobotError: A value is not finite.
    """
    seen = parts_of(percept)
    position = torch.cat([seen.object, seen.height])[None]
    ways = arm_ways(robot, position, torch.cat([seen.table, seen.height])[None])
    if not bool(ways.found[0]):
        return None
    which = int(ways.arm[0])
    arm, way = robot.arms[which], way_of(robot, ways, 0)
    urdf = [robot.urdf.joint(name) for name in arm.joint_names]
    every = legs(way, numpy.array([limit_of(joint, "velocity", SPEED) for joint in urdf]))
    there = numpy.concatenate(every[:-1])
    held = numpy.repeat(there[-1:], round(CLOSING / TICK), 0)
    rows = numpy.concatenate([there, held, every[-1]])
    pick = [*range(EVERY - 1, len(rows), EVERY)]
    pick = sorted({*pick, len(there) - 1, len(there) + len(held) - 1, len(rows) - 1})
    fingers = [joint for joint in gripper_joints(robot, which) if joint.mimic is None]
    open_ = [float(robot.description.held.get(joint.name, 0.0)) for joint in fingers]
    closed = [closed_at(joint, robot) for joint in fingers]
    return {
        "arm": arm.name,
        "joints": list(arm.joint_names),
        "gripper": [joint.name for joint in fingers],
        "times": [(k + 1) * TICK for k in pick],
        "positions": rows[pick].tolist(),
        "openings": [open_ if k < len(there) else closed for k in pick],
        "effort": [
            min(limit_of(j, "effort", GRIP[1]), GRIP[j.type == "prismatic"]) for j in fingers
        ],
    }
