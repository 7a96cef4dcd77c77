"""The robot's rigid bodies: its links, merged where no moving joint is between them.

A simulation moves the joints of one arm, or none while the base drives. All others are fixed as in
the description or the home posture, since fewer joints are fewer equations to solve.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy
from numpy.typing import NDArray

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf

Array = NDArray[numpy.float64]

LEAST_MASS = 1e-3  # kg
LEAST_INERTIA = 1e-5  # kg m²


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


def rigid_bodies(
    robot: Robot, moving: Collection[str], held: Mapping[str, float]
) -> list[RigidBody]:
    """The bodies of a robot with some moving joints, parents first.

    Other joints are at their `held` positions (rad or m), or at 0. RobotError if a link's mass or
    inertia is impossible.
    """
    urdf, base = robot.urdf, robot.description.base_frame
    place = _placed(urdf, base, moving, held)
    joints = {joint.child: joint for joint in urdf.model.robot.joints}
    links = {link.name: link for link in urdf.model.robot.links}
    members: dict[str, list[str]] = {}
    for name, (body, _) in place.items():
        members.setdefault(body, []).append(name)
    bodies = []
    for body, names in members.items():
        joint = joints[body] if body != base else None
        parent, pose = place[joint.parent] if joint is not None else ("", numpy.eye(4))
        pose = pose @ _origin(joint) if joint is not None else pose
        shapes = [s for n in names for s in _shapes(robot, links[n], place[n][1])]
        mass = _mass([(links[n], place[n][1]) for n in names])
        bodies.append(RigidBody(body, parent, pose, joint, tuple(shapes), *mass))
    return bodies


def _placed(
    urdf: Urdf, base: str, moving: Collection[str], held: Mapping[str, float]
) -> dict[str, tuple[str, Array]]:
    """The body of every link, and the link's pose (4, 4) in that body, parents first."""
    root: Array = numpy.asarray(numpy.linalg.inv(_to_root(urdf, base, held)), dtype=numpy.float64)
    place: dict[str, tuple[str, Array]] = {urdf.model.base_link: (base, root)}
    waiting = list(urdf.model.robot.joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in place]
        waiting = [joint for joint in waiting if joint.parent not in place]
        for joint in ready:
            body, pose = place[joint.parent]
            if joint.name in moving:
                place[joint.child] = (joint.child, numpy.eye(4))
            else:
                place[joint.child] = (body, pose @ _origin(joint) @ motion(joint, held))
    return place


def _to_root(urdf: Urdf, base: str, held: Mapping[str, float]) -> Array:
    """(4, 4): the pose of the base frame in that of the URDF's root."""
    pose = numpy.eye(4)
    for joint in reversed(urdf.joints_above(base, urdf.model.base_link)):
        pose = pose @ _origin(joint) @ motion(joint, held)
    return pose


def _origin(joint: Any) -> Array:
    return numpy.eye(4) if joint.origin is None else numpy.asarray(joint.origin, dtype=float)


def motion(joint: Any, held: Mapping[str, float]) -> Array:
    """(4, 4): the transform of a fixed joint to its child, also if it follows another joint."""
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


def mimic_of(joint: Any) -> tuple[float, float]:
    """Offset and factor of a joint that follows another."""
    factor = joint.mimic.multiplier
    return joint.mimic.offset or 0.0, 1.0 if factor is None else factor


def follows(joint: Any, held: Mapping[str, float]) -> float:
    """The position (rad or m) of a joint that follows a fixed one."""
    offset, factor = mimic_of(joint)
    return offset + factor * held.get(joint.mimic.joint, 0.0)


def _shapes(robot: Robot, link: Any, pose: Array) -> list[Shape]:
    """Collision shapes of a link at a pose in its body: the URDF's, or their replacements."""
    given = robot.description.capsules.get(link.name)
    if given is not None:
        return [_capsule(link.name, numpy.array(row), pose) for row in given]
    out = []
    for collision in link.collisions:
        shape, at = collision.geometry, collision.origin
        at = pose @ (numpy.eye(4) if at is None else numpy.asarray(at, dtype=float))
        if shape.sphere is not None:
            out.append(Shape(link.name, "sphere", (shape.sphere.radius,), at))
        elif shape.cylinder is not None:
            size = shape.cylinder.radius, shape.cylinder.length / 2
            out.append(Shape(link.name, "cylinder", size, at))
        elif shape.box is not None:
            out.append(Shape(link.name, "box", tuple(s / 2 for s in shape.box.size), at))
    return [s for s in out if min(s.size) > 0]


def _capsule(link: str, row: Array, pose: Array) -> Shape:
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


def _mass(links: list[tuple[Any, Array]]) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about the centre of links at poses in one body."""
    parts = []
    for link, pose in links:
        if link.inertial is None or not link.inertial.mass:
            continue
        inertial = link.inertial
        at = pose if inertial.origin is None else pose @ numpy.asarray(inertial.origin, dtype=float)
        own = numpy.zeros((3, 3)) if inertial.inertia is None else numpy.asarray(inertial.inertia)
        if inertial.mass < 0 or numpy.linalg.eigvalsh(own).min() < -1e-9:
            raise RobotError(
                f"link {link.name!r} has a mass of {inertial.mass} kg and an inertia with the "
                f"diagonal {own.diagonal().tolist()}: give a mass and principal moments above 0"
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
