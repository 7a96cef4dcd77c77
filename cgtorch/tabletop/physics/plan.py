"""Rows of numbers that a simulation is asked with: what the robot knows, and the way it plans.

The table is known as it is, as a robot's own segmentation sees it; the object is where the last
percept has it, with its noise.
"""

import numpy
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.tabletop.kinematics import ArmWay, Robot, arm_ways
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT
from cgtorch.tabletop.physics.grasp import Way
from cgtorch.tabletop.world.geometry import rectangle_in_frame

SEEN = 3
"""Numbers of where the object's centre is seen, in the base frame (m), at the end of a row."""


def planned(robot: Robot, rows: Tensor) -> ArmWay:
    """The ways of an arm to objects; rows (n, ...) begin with pose and table, and end with `SEEN`.

    A grasp is planned for an object's middle at `GRASP_HEIGHT` over what it stands on.
    """
    pose, table, seen = rows[:, :3], rows[:, 3:9], rows[:, -SEEN:]
    here = torch.cat([rectangle_in_frame(pose, table[:, :5]), table[:, 5:6]], 1)
    foot = seen - seen.new_tensor([0.0, 0.0, GRASP_HEIGHT])
    return arm_ways(robot, foot, here)


def way_of(robot: Robot, ways: ArmWay, row: int) -> Way:
    """The way of one row."""
    joints = len(robot.arms[int(ways.arm[row])].joint_names)
    lifted = int(ways.lifted[row])
    postures: NDArray[numpy.float64] = ways.joints[row, : lifted + 1, :joints].double().numpy()
    return Way(postures, int(ways.pre_grasp[row]), int(ways.grasp[row]), lifted)
