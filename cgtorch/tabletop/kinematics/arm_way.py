"""The way of an arm: from home to an object, up with it, and back."""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.grasping import APPROACHES, grasp_solution, table_slab, waypoints
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.touching import touches

LINE = 41
"""Waypoints from the pre-grasp over the grasp to where the object is lifted."""
STEPS = 100


@dataclass(frozen=True)
class ArmWay:
    """How an arm takes each object: ways in the space of its joints, straight between waypoints.

    Attributes:
        found: (B,) whether there is a way at all; where not, the rest means nothing.
        arm: (B,) index into the robot's arms.
        approach: (B,) index into `APPROACHES`.
        joints: (B, W, n) waypoints from home to where the object is lifted, rad or m, in the order
            of the arm's joints; n is the largest number of joints of any arm, and what an arm does
            not have is 0. After a row's last waypoint it is repeated.
        pre_grasp, grasp, lifted: (B,) index of these waypoints; `lifted` is a row's last one. Until
            `pre_grasp` the way is free in space, then the tool keeps to its line.
        back: (B, V, n) waypoints with the object, from where it is lifted to home.
        home_again: (B,) index of the last waypoint of `back`, and
        returns: (B,) whether the arm can bring the object home; where not, `back` ends earlier.
    """

    found: Tensor
    arm: Tensor
    approach: Tensor
    joints: Tensor
    pre_grasp: Tensor
    grasp: Tensor
    lifted: Tensor
    back: Tensor
    home_again: Tensor
    returns: Tensor


def arm_ways(robot: Robot, position: Tensor, table: Tensor, seed: int = 0) -> ArmWay:
    """The way of an arm to each object, and back with it.

    Args:
        robot: The robot, whose arms are at home.
        position: (B, 3) objects on the table in the base frame, at the height of its top, m.
        table: (B, 6) centre x, centre y, yaw, size x, size y, height of the top, in the base
            frame, m and rad.
        seed: Of the planner's random numbers, which are each row's own.

    Raises:
        RobotError: A shape is wrong or a value is not finite.
    """
    solution = grasp_solution(robot, position, table)
    rows, n = len(position), solution.joints.shape[-1]
    joints = position.new_zeros(rows, LINE + 1, n)
    found = solution.found.clone()
    for row in found.nonzero()[:, 0].tolist():
        which = int(solution.arm[row])
        arm = robot.arms[which]
        k = len(arm.joint_names)
        home = robot.home[which].to(position)
        path = waypoints(position[row : row + 1], *APPROACHES[int(solution.approach[row])])
        share = torch.linspace(0, 1, LINE // 2 + 1).to(path)[:, None, None]
        half = path[0, :1] + share * (path[0, 2:3] - path[0, :1])
        lift = path[0, 2:3] + share[1:] * (path[0, 4:5] - path[0, 2:3])
        line, reached = arm.follow(solution.joints[row, 2:3, :k], torch.cat([half, lift])[None])
        way = [home]
        for q in line[0]:
            way.append(way[-1] + arm.difference(q, way[-1]))
        joints[row, :, :k] = torch.stack(way)
        at = torch.linspace(0, 1, STEPS).to(path)[:, None]
        straight = torch.cat([way[0] + at * (way[1] - way[0]), torch.stack(way[1:])])
        slab = table_slab(table[row : row + 1].to(position))
        hit = touches(arm, straight, slab, robot.body.to(position)).any()
        found[row] = bool(reached.all()) & ~hit
    index = torch.zeros(rows, dtype=torch.long)
    return ArmWay(
        found, solution.arm, solution.approach, joints, index + 1, index + 1 + LINE // 2,
        index + LINE, joints[:, [LINE, 0]], index + 1, found,
    )  # fmt: skip
