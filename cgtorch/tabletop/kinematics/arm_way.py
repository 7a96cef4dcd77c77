"""The way of an arm: from home to an object, up with it, and home again.

A way is a path in joint space, straight between waypoints.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.ground.counter_rng import words
from cgtorch.tabletop.kinematics.clear_ways import ways_clear
from cgtorch.tabletop.kinematics.grasp_lines import HALF, LINE
from cgtorch.tabletop.kinematics.grasping import APPROACHES, table_slab
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.rrt_connect import VIAS, ways_planned
from cgtorch.tabletop.kinematics.scene import CARRY
from cgtorch.tabletop.kinematics.way_search import FoundWays, found_ways, places_of, row_keys


@dataclass(frozen=True)
class ArmWay:
    """The ways of arms to B objects: paths in joint space, straight between waypoints.

    Attributes:
        found: (B,) whether there is a way; if not, all other values of the row are meaningless.
        arm: (B,) index into the robot's arms.
        approach: (B,) index into `APPROACHES`.
        joints: (B, W, n) waypoints from home to where the object is lifted, rad or m, in the order
            of the arm's joints. n is the largest number of joints of any arm, and missing joints
            are 0. A row's last waypoint is repeated.
        pre_grasp, grasp, lifted: (B,) indices of these waypoints; `lifted` is a row's last one.
            Before `pre_grasp`, the way is free in space; after it, the tool keeps to its line.
        back: (B, V, n) waypoints with the object, from where it is lifted to home.
        home_again: (B,) index of the last waypoint of `back`.
        returns: (B,) whether the arm can bring the object home; if not, `back` ends where the
            object is lifted.
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
        robot: The robot, with its arms at home.
        position: (B, 3) objects on the table in the base frame, at the height of its top, m.
        table: (B, 6) centre x, centre y, yaw, size x, size y, height of the top, in the base frame,
            m and rad.
        seed: Of the planner's random numbers, which are independent for each row.

    Raises:
        RobotError: A shape is wrong, or a value is not finite.
    """
    ways, arms = found_ways(robot, position, table, seed), len(robot.arms)
    found, arm = ways.rank < arms * len(APPROACHES), ways.rank % arms
    n = ways.line.shape[2]
    home = torch.stack([torch.nn.functional.pad(q, (0, n - len(q))) for q in robot.home])
    home = home.to(ways.line)[arm]
    before = torch.where(ways.count > 0, ways.count - 1, 1)
    index = torch.arange(VIAS - 1 + LINE, device=arm.device).expand(len(arm), -1)
    vias = torch.where((ways.count > 0)[:, None, None], ways.vias, home[:, None])
    both = torch.cat([vias[:, : VIAS - 1], ways.line], 1)
    lifted = before + LINE - 1
    which = index.minimum(lifted[:, None])
    which = torch.where(which < before[:, None], which, which - before[:, None] + VIAS - 1)
    joints = both.gather(1, which[..., None].expand(-1, -1, n))
    back, count = _ways_back(robot, position, table, ways, home, found, seed)
    most = int(lifted[found].max()) + 1 if bool(found.any()) else 1
    return ArmWay(
        found, arm, ways.rank // arms, joints[:, :most].to(position), before, before + HALF, lifted,
        back.to(position), count - 1, found & (count > 1),
    )  # fmt: skip


def graspable(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
    """(B,) whether an arm has a way to each object and up with it; see `arm_ways`."""
    return found_ways(robot, position, table).rank < len(robot.arms) * len(APPROACHES)


def _ways_back(
    robot: Robot, position: Tensor, table: Tensor, ways: FoundWays, home: Tensor, found: Tensor,
    seed: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Ways (B, VIAS, n) home with the object, straight if that is clear, and their lengths (B,)."""
    back = ways.line[:, -1:].repeat(1, VIAS, 1)
    count = torch.ones_like(ways.rank)
    places = replace(places_of(position, table_slab(table.to(position))), held=ways.held)
    keys = row_keys(position, table, seed)
    for which, arm in enumerate(robot.arms):
        n, scene = len(arm.joint_names), robot.scenes[which]
        rows = (found & (ways.rank % len(robot.arms) == which)).nonzero()[:, 0]
        ends = torch.stack([ways.line[rows, -1, :n], home[rows, :n]], 1)
        kind = torch.full_like(rows, CARRY)
        straight = ways_clear(arm, scene, places[rows], kind, ends)
        done = rows[straight]
        back[done, 1:, :n], count[done] = home[done, None, :n], 2
        left, ends = rows[~straight], ends[~straight]
        key = words(keys[left], torch.full_like(left, -1))
        vias, length = ways_planned(arm, scene, places[left], kind[: len(left)], ends, key)
        planned = length > 0
        last = torch.arange(VIAS).minimum(length[planned, None] - 1)
        vias = vias[planned].gather(1, last[..., None].expand(-1, -1, n))
        back[left[planned], :, :n], count[left[planned]] = vias, length[planned]
    return back, count
