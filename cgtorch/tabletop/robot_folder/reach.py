"""What a robot can grasp on a table before it, and where it cannot, why."""

import math
from dataclasses import dataclass

import numpy as np
import torch

from cgtorch.tabletop.kinematics import Robot, graspable
from cgtorch.tabletop.kinematics.urdf import MOVING, at_rest
from cgtorch.tabletop.robot_folder.structure import Structure

DEPTH, WIDTH, HEIGHT = 0.8, 1.6, 0.75  # m, of the table on which a robot is tried
OTHERS = (
    1.2,
    0.9,
    0.6,
    0.45,
    0.3,
    0.15,
    0.05,
)  # m: other heights, where nothing on that is grasped
AHEAD = 0.05  # m from the footprint to that table
TURNED = 60  # degrees from x at rest that are told
SIDEWAYS = 0.2  # of an arm's length, how far it leads to the side at least to point somewhere
DEPTHS, ASIDE = (0.1, 0.2, 0.3), (-0.3, 0.0, 0.3)  # m: where objects are on it


@dataclass(frozen=True)
class Reached:
    """Which objects on a table right before a robot it can grasp.

    Attributes:
        grasps: (9,) bool.
        why: Why there is none, and what suits better, in a sentence; "" if there is one.
    """

    grasps: torch.Tensor
    why: str = ""


def reached(robot: Robot) -> Reached:
    """What a robot can grasp on a table of usual height, and if nothing, why."""
    grasps = _tried(robot, HEIGHT)
    if grasps.any():
        return Reached(grasps)
    better = {height: int(_tried(robot, height).sum()) for height in OTHERS}
    best = max(better, key=lambda height: better[height])
    also = (
        f"at {best:g} m it can grasp {better[best]} of {len(grasps)}, so make tables of that height"
    )
    if not better[best]:
        also = (
            f"nor at any height from {min(OTHERS):g} to {max(OTHERS):g} m: check that x leads "
            "forward, the tool frame, and the limits of joints"
        )
    nearest = min((_lacking(robot, i) for i in range(len(robot.arms))), key=lambda far: far[0])
    return Reached(grasps, f"{nearest[1]}; {also}")


def _objects(robot: Robot, height: float) -> torch.Tensor:
    edge = robot.description.footprint[1] + AHEAD
    return torch.tensor([[edge + x, y, height] for x in DEPTHS for y in ASIDE])


def _tried(robot: Robot, height: float) -> torch.Tensor:
    """(9,) which objects on a table of that height the robot can grasp."""
    objects = _objects(robot, height)
    edge = robot.description.footprint[1] + AHEAD
    table = torch.tensor([edge + DEPTH / 2, 0.0, 0.0, DEPTH, WIDTH, height])
    return graspable(robot, objects, table.expand(len(objects), 6))


def _lacking(robot: Robot, number: int) -> tuple[float, str]:
    """How far an arm is too short for the nearest object, m, and what that says."""
    words = robot.description
    arm, structure = words.arms[number], Structure(robot.urdf, words.base_frame)
    joints = robot.urdf.joints_between(arm.base_link, arm.tool_frame)
    moving = [joint for joint in joints if joint.type in MOVING]
    robot.urdf.model.update_cfg({joint.name: at_rest(joint) for joint in moving})
    places = np.stack(
        [structure.pose(link)[:3, 3] for link in [*(j.child for j in moving), arm.tool_frame]]
    )
    length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    away = np.linalg.norm(_objects(robot, HEIGHT).numpy() - places[0], axis=1)
    about = f"arm {arm.name!r} is {length:.2f} m long from its shoulder, {places[0, 2]:.2f} m high"
    near, (x, y) = float(away.min()), (places[-1] - places[0])[:2]
    if (
        math.hypot(x, y) > SIDEWAYS * length
        and abs(turn := math.degrees(math.atan2(y, x))) > TURNED
    ):
        about += f", and at rest it points {turn:.0f} degrees away from x"
    if near > length:
        return near - length, f"{about}, and the nearest object {near:.2f} m away from that"
    return 0.0, f"{about}, but no posture leads to an object and up with it and touches nothing"
