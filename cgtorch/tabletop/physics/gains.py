"""Parameters of servos: defaults for any robot, with the values of its description."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics.bodies import RigidBody

STIFFNESS = (800.0, 100.0)  # N m/rad of an arm's first joint and of its last
ARMATURE = (0.1, 0.02)  # kg m² of rotor and gears, of the same
SLIDING = 20.0  # how much stiffer, N/m, a joint that slides is
GRIP = (5.0, 50.0)  # N m of a finger that turns, N of one that slides, at most
FINGER = (100.0, 5000.0)  # N m/rad, N/m
FINGER_ARMATURE = (0.01, 1.0)  # kg m², kg
EFFORT = 30.0  # N m or N, of a joint whose URDF names none
SPEED = 1.0  # rad/s, or m/s, of the same
BASE_DAMPING = 32.0  # 1/s by the robot's mass: the base follows within 30 ms
TURN_DAMPING = 60.0  # 1/s by its inertia about the vertical axis
BASE_FORCE = 2.4  # m/s² that the wheels can give its mass
TURN_FORCE = 6.0  # rad/s² that they can give its inertia


@dataclass(frozen=True)
class Gains:
    """Servos by joint: stiffness, maximum force, maximum speed, armature.

    Those of the base are its damping (x, y, turn), force (N) and torque (N m).
    """

    stiffness: Mapping[str, float]
    force: Mapping[str, float]
    speed: Mapping[str, float]
    armature: Mapping[str, float]
    base_damping: tuple[float, float, float]
    base_force: float
    base_torque: float


def gains_of(robot: Robot, arm: int | None, bodies: list[RigidBody]) -> Gains:
    """The servos of the base, of an arm if there is one, and of its gripper."""
    order = () if arm is None else robot.arms[arm].joint_names
    given = robot.description.gains
    stiffness, force, speed, armature = {}, {}, {}, {}
    for body in bodies:
        if (joint := body.joint) is None:
            continue
        name, slides = joint.name, joint.type == "prismatic"
        effort = limit_of(joint, "effort", EFFORT)
        speed[name] = limit_of(joint, "velocity", SPEED)
        if name in order:
            share = order.index(name) / max(1, len(order) - 1)
            usual = _between(STIFFNESS, share) * (SLIDING if slides else 1.0)
            force[name], armature[name] = effort, _between(ARMATURE, share)
        else:
            usual, armature[name] = FINGER[slides], FINGER_ARMATURE[slides]
            force[name] = min(effort, GRIP[slides])
        stiffness[name] = given.get(name, usual)
    mass, turning = sum(body.mass for body in bodies), max(1.0, _about_vertical(bodies))
    base = BASE_DAMPING * mass, BASE_DAMPING * mass, TURN_DAMPING * turning
    return Gains(stiffness, force, speed, armature, base, BASE_FORCE * mass, TURN_FORCE * turning)


def _between(ends: tuple[float, float], share: float) -> float:
    """Geometric interpolation between two positive numbers."""
    return ends[0] * (ends[1] / ends[0]) ** share


def limit_of(joint: Any, what: str, usual: float) -> float:
    """The effort or velocity of a `yourdfpy` joint, or a default if the URDF has none."""
    value = None if joint.limit is None else getattr(joint.limit, what)
    return float(value) if value is not None and 0 < value < 1e6 else usual


def _about_vertical(bodies: list[RigidBody]) -> float:
    """The approximate inertia of the robot about its own vertical axis, kg m²."""
    base = bodies[0]
    return float(base.inertia[2, 2] + base.mass * (base.centre[:2] @ base.centre[:2]))
