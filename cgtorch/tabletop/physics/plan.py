"""Inputs of grasp simulations: what the robot knows, and the way that it plans.

The table is known exactly, as from a robot's own segmentation. The object is where the last percept
has it, with noise.
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
"""Numbers at the end of a row: the perceived centre of the object, in the base frame (m)."""


def planned(robot: Robot, rows: Tensor) -> ArmWay:
    """The ways of an arm to objects; rows (n, ...) begin with pose and table, and end with `SEEN`.

    A grasp is planned for an object's centre at `GRASP_HEIGHT` above its support.
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
