"""The robot's rigid bodies, fingers and servos, in a simulation that moves one arm or the base.

Links without a moving joint between them are one body: fewer joints are fewer equations.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy
from numpy.typing import NDArray

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.urdf import MOVING, mimic_of

Array = NDArray[numpy.float64]
Placed = tuple[Any, Array]  # a `yourdfpy` link, and its pose (4, 4) in its body

LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-5  # kg, kg m²
STIFFNESS = (800.0, 100.0)  # N m/rad of an arm's first joint and of its last
ARMATURE = (0.1, 0.02)  # kg m² of rotor and gears, of the same
SLIDING = 20.0  # factor of a joint that slides, N/m instead of N m/rad
GRIP = (5.0, 50.0)  # greatest force of a finger that turns, N m, and of one that slides, N
FINGER = (100.0, 5000.0)  # stiffness of the same, N m/rad, N/m
FINGER_ARMATURE = (0.01, 1.0)  # kg m², kg
EFFORT, SPEED = 30.0, 1.0  # N m (or N) and rad/s (or m/s), of a joint whose URDF names none
BASE_DAMPING, TURN_DAMPING = 32.0, 60.0  # 1/s by mass and inertia: the base lags 30 ms
BASE_FORCE, TURN_FORCE = 2.4, 6.0  # greatest acceleration by the wheels, m/s², rad/s²


@dataclass(frozen=True)
class Shape:
    """A collision shape: sphere (radius), cylinder or capsule (radius, half length), box (halves).

    Attributes:
        link: The URDF link to which it belongs.
        pose: (4, 4) in the frame of its body, m; cylinders and capsules lie along z.
    """

    link: str
    kind: str
    size: tuple[float, ...]
    pose: Array


@dataclass(frozen=True)
class RigidBody:
    """Links that move as one.

    Attributes:
        name: The name of the link that its joint moves, or that of the base frame.
        parent: The body from which it hangs; "" for the base.
        pose: (4, 4) of its frame in that of its parent with the joint at 0.
        joint: The `yourdfpy` joint, None for the base.
        shapes: Collision shapes in its frame.
        mass: In kg.
        centre: (3,) the centre of mass, m.
        inertia: (3, 3) about the centre of mass, kg m².
    """

    name: str
    parent: str
    pose: Array
    joint: Any
    shapes: tuple[Shape, ...]
    mass: float
    centre: Array
    inertia: Array


class Servo(NamedTuple):
    """A joint's servo: stiffness, greatest force and speed, armature; in rad or m, N m or N."""

    stiffness: float
    force: float
    speed: float
    armature: float


def rigid_bodies(
    robot: Robot, moving: Collection[str], held: Mapping[str, float]
) -> list[RigidBody]:
    """The bodies of a robot with some moving joints, parents first.

    Other joints are at their `held` positions (rad or m), or at 0. RobotError if a link's inertia
    is impossible.
    """
    base, model = robot.description.base_frame, robot.urdf.model
    place = _placed(robot, moving, held)
    joints = {joint.child: joint for joint in model.robot.joints}
    members: dict[str, list[Placed]] = {}
    for name, (body, pose) in place.items():
        members.setdefault(body, []).append((model.link_map[name], pose))
    bodies = []
    for body, links in members.items():
        joint, parent, pose = None, "", numpy.eye(4)
        if body != base:
            joint = joints[body]
            parent, pose = place[joint.parent]
            pose = pose @ _origin(joint)
        shapes = tuple(shape for link in links for shape in _shapes(robot, *link))
        bodies.append(RigidBody(body, parent, pose, joint, shapes, *_mass(links)))
    return bodies


def _placed(
    robot: Robot, moving: Collection[str], held: Mapping[str, float]
) -> dict[str, tuple[str, Array]]:
    """The body of every link, and the link's pose (4, 4) in that body, parents first."""
    base, urdf = robot.description.base_frame, robot.urdf
    root, to_root = urdf.model.base_link, numpy.eye(4)
    for joint in reversed(urdf.joints_above(base, root)):
        to_root = to_root @ _origin(joint) @ _motion(joint, held)
    place = {root: (base, numpy.asarray(numpy.linalg.inv(to_root), dtype=numpy.float64))}
    waiting = list(urdf.model.robot.joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in place]
        waiting = [joint for joint in waiting if joint.parent not in place]
        for joint in ready:
            body, pose = place[joint.parent]
            still = body, pose @ _origin(joint) @ _motion(joint, held)
            place[joint.child] = (joint.child, numpy.eye(4)) if joint.name in moving else still
    return place


def _origin(element: Any) -> Array:
    """(4, 4): the origin of a `yourdfpy` element, the identity if it has none."""
    return numpy.eye(4) if element.origin is None else numpy.asarray(element.origin, dtype=float)


def _motion(joint: Any, held: Mapping[str, float]) -> Array:
    """(4, 4): the transform of a joint that is held, or follows one that is."""
    if joint.type not in MOVING:
        return numpy.eye(4)
    value = held.get(joint.name, 0.0) if joint.mimic is None else follows(joint, held)
    pose, axis = numpy.eye(4), numpy.asarray(joint.axis, dtype=float)
    if joint.type == "prismatic":
        pose[:3, 3] = value * axis
        return pose
    x, y, z = axis
    cross = numpy.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    pose[:3, :3] += numpy.sin(value) * cross + (1 - numpy.cos(value)) * cross @ cross
    return pose


def follows(joint: Any, held: Mapping[str, float]) -> float:
    """The position (rad or m) of a joint that follows a fixed one."""
    offset, factor = mimic_of(joint)
    return offset + factor * held.get(joint.mimic.joint, 0.0)


def _shapes(robot: Robot, link: Any, pose: Array) -> list[Shape]:
    """Collision shapes of a link at a pose in its body: the URDF's, or their replacements."""
    given = robot.description.capsules.get(link.name)
    if given is not None:
        return [_capsule(link.name, numpy.array(row), pose) for row in given]
    found = []
    for collision in link.collisions:
        shape, size = collision.geometry, tuple[float, ...]()
        if shape.sphere is not None:
            kind, size = "sphere", (shape.sphere.radius,)
        elif shape.cylinder is not None:
            kind, size = "cylinder", (shape.cylinder.radius, shape.cylinder.length / 2)
        elif shape.box is not None:
            kind, size = "box", tuple(side / 2 for side in shape.box.size)
        if min(size, default=0) > 0:
            found.append(Shape(link.name, kind, size, pose @ _origin(collision)))
    return found


def _capsule(link: str, row: Array, pose: Array) -> Shape:
    """The capsule of a row: its ends x, y, z, and its radius, m."""
    start, end, radius = row[:3], row[3:6], float(row[6])
    along, at = end - start, numpy.eye(4)
    length = float(numpy.linalg.norm(along))
    if length > 0:
        z = along / length
        x = numpy.cross(z, numpy.eye(3)[numpy.abs(z).argmin()])
        x /= numpy.linalg.norm(x)
        at[:3, :3] = numpy.stack([x, numpy.cross(z, x), z], 1)
    at[:3, 3] = (start + end) / 2
    if length < 1e-9:
        return Shape(link, "sphere", (radius,), pose @ at)
    return Shape(link, "capsule", (radius, length / 2), pose @ at)


def _mass(links: list[Placed]) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about the centre of links in one body."""
    parts = []
    for link, pose in links:
        inertial = link.inertial
        if inertial is None or not inertial.mass:
            continue
        at = pose @ _origin(inertial)
        own = numpy.zeros((3, 3)) if inertial.inertia is None else numpy.asarray(inertial.inertia)
        if numpy.linalg.eigvalsh(own).min() < -1e-9:
            raise RobotError(
                f"link {link.name!r} has an inertia with the diagonal {own.diagonal().tolist()} "
                "and a principal moment below 0: give principal moments above 0"
            )
        parts.append((inertial.mass, at[:3, 3], at[:3, :3] @ own @ at[:3, :3].T))
    mass = sum(part[0] for part in parts)
    if mass < LEAST_MASS:
        return LEAST_MASS, numpy.zeros(3), LEAST_INERTIA * numpy.eye(3)
    centre = numpy.asarray(sum(m * at for m, at, _ in parts)) / mass
    total = LEAST_INERTIA * numpy.eye(3)
    for m, at, own in parts:
        away = at - centre
        total = total + own + m * (away @ away * numpy.eye(3) - numpy.outer(away, away))
    return mass, centre, total


def followers_of(robot: Robot, arm: int) -> list[Any]:
    """The joints (of `yourdfpy`) within an arm that follow others."""
    words = robot.description.arms[arm]
    joints = robot.urdf.joints_between(words.base_link, words.tool_frame)
    return [joint for joint in joints if joint.mimic is not None]


def gripper_joints(robot: Robot, arm: int) -> list[Any]:
    """The moving joints (of `yourdfpy`) that hang from an arm's last joint."""
    last, urdf = robot.arms[arm].joint_names[-1], robot.urdf
    return [
        joint
        for joint in urdf.model.robot.joints
        if joint.type in MOVING
        and any(above.name == last for above in urdf.joints_above(joint.parent, ""))
    ]


def closed_at(joint: Any, robot: Robot) -> float:
    """The closed position of a finger (rad or m): its limit farther from the described position.

    A finger that the description does not name stays where it is.
    """
    held = robot.description.held
    begin = float(held.get(joint.name, 0.0))
    if joint.name not in held or joint.type == "continuous":
        return begin
    return max(float(joint.limit.lower), float(joint.limit.upper), key=lambda x: abs(x - begin))


def servos_of(robot: Robot, arm: int | None, bodies: list[RigidBody]) -> dict[str, Servo]:
    """The servos of an arm and its gripper by joint; the description's stiffness comes first."""
    order = () if arm is None else robot.arms[arm].joint_names
    servos = {}
    for joint in (body.joint for body in bodies if body.joint is not None):
        slides = joint.type == "prismatic"
        force, speed = limit_of(joint, "effort", EFFORT), limit_of(joint, "velocity", SPEED)
        if joint.name in order:
            share = order.index(joint.name) / max(1, len(order) - 1)
            stiffness = _between(STIFFNESS, share) * (SLIDING if slides else 1.0)
            armature = _between(ARMATURE, share)
        else:
            stiffness, armature = FINGER[slides], FINGER_ARMATURE[slides]
            force = min(force, GRIP[slides])
        stiffness = robot.description.gains.get(joint.name, stiffness)
        servos[joint.name] = Servo(stiffness, force, speed, armature)
    return servos


def base_servos(bodies: list[RigidBody]) -> list[tuple[float, float]]:
    """Damping and greatest force of the base along x and y and, in N m, of its turn."""
    base, mass = bodies[0], sum(body.mass for body in bodies)
    about_vertical = base.inertia[2, 2] + base.mass * (base.centre[:2] @ base.centre[:2])
    turning = max(1.0, float(about_vertical))
    drive = BASE_DAMPING * mass, BASE_FORCE * mass
    return [drive, drive, (TURN_DAMPING * turning, TURN_FORCE * turning)]


def _between(ends: tuple[float, float], share: float) -> float:
    """Geometric interpolation between two positive numbers."""
    return ends[0] * (ends[1] / ends[0]) ** share


def limit_of(joint: Any, what: str, usual: float) -> float:
    """The effort or velocity of a `yourdfpy` joint, or a default if the URDF has none."""
    value = None if joint.limit is None else getattr(joint.limit, what)
    return float(value) if value is not None and 0 < value < 1e6 else usual
