"""The joints of an arm's fingers, and their closed positions."""

from typing import Any

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.urdf import MOVING


def gripper_joints(robot: Robot, arm: int) -> list[Any]:
    """The moving joints (of `yourdfpy`) that hang from an arm's last joint."""
    last = robot.arms[arm].joint_names[-1]
    every = {joint.name: joint for joint in robot.urdf.model.robot.joints}
    tip = every[last].child
    return [
        joint
        for joint in every.values()
        if joint.type in MOVING and joint.name != last
        and any(above.child == tip for above in robot.urdf.joints_above(joint.child, ""))
    ]  # fmt: skip


def closed_at(joint: Any, robot: Robot) -> float:
    """The closed position of a finger (rad or m): its limit farther from the described position.

    A finger that the description does not name stays where it is.
    """
    held = robot.description.held
    begin = float(held.get(joint.name, 0.0))
    if joint.name not in held or joint.type == "continuous":
        return begin
    return max(float(joint.limit.lower), float(joint.limit.upper), key=lambda x: abs(x - begin))
