"""The robot, a table, boxes on the floor and an object as a MuJoCo model.

One model serves all scenes with the same number of boxes; positions and sizes are written into it
before each simulation (`cgtorch.tabletop.physics.scene`).
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, TypeAlias

import numpy
from numpy.typing import NDArray

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.urdf import mimic_of
from cgtorch.tabletop.physics.bodies import (
    RigidBody,
    Servo,
    base_servos,
    closed_at,
    followers_of,
    follows,
    gripper_joints,
    rigid_bodies,
    servos_of,
)

TIMESTEP = 0.005  # s
IMPRATIO = 10.0
FLOOR = 2  # the collision bit of what the floor stops, which the robot stands on anyway
NEIGHBOURS = 2
"""Bodies of an arm with at most this many joints between them do not collide by design."""
SHOULDER = 3
"""Bodies of an arm that hang from at most this many joints do not collide with the robot's body."""
METAL, GREY, WOOD, BROWN, GREEN = (
    [0.75, 0.77, 0.8, 1], [0.55, 0.56, 0.58, 1], [0.72, 0.55, 0.38, 1], [0.5, 0.35, 0.3, 1],
    [0.1, 0.55, 0.3, 1],
)  # fmt: skip
AMBIENT, DIFFUSE = [0.4, 0.4, 0.4], [0.5, 0.5, 0.5]
LAMP: dict[str, Any] = {"pos": [0, 0, 4], "castshadow": False}
GROUND = ("slab", "block")
BASE = ("base x", "base y", "base turn")


def mujoco() -> Any:
    """MuJoCo, an optional package; SettingsError, with the way to install it, if it is missing."""
    if find_spec("mujoco") is None:
        raise SettingsError(
            "the world mujoco needs package 'mujoco'; pip install 'cgtorch[physics]', or use "
            "world 'kinematic' (--world kinematic)"
        )
    import mujoco as module

    return module


@dataclass(frozen=True)
class Thing:
    """The object on the table: a cylinder (radius, half height) or a box (half sides), m.

    Attributes:
        kind: cylinder or box.
        mass: In kg.
        friction: The sliding friction coefficient with anything that is not rougher.
    """

    kind: str = "cylinder"
    size: tuple[float, ...] = (0.025, 0.05)
    mass: float = 0.2
    friction: float = 1.0

    @property
    def half_height(self) -> float:
        """The half height of the standing object, m."""
        return self.size[-1]


@dataclass(frozen=True)
class Joint:
    """A joint with a servo, and its indices in qpos and ctrl.

    Attributes:
        lag: The time, in s, by which the servo's damping delays it behind a moving target.
        speed: Its greatest speed, rad/s or m/s.
        open: Where it begins, rad or m: the home position of an arm's joint.
        closed: Where a finger grasps.
    """

    name: str
    qpos: int
    ctrl: int
    lag: float
    speed: float
    open: float
    closed: float


@dataclass(frozen=True)
class Model:
    """A compiled model, and the indices of its parts.

    Attributes:
        model, data: MuJoCo's own.
        arm: Joints of the moving arm, from base to tool.
        fingers: Joints of its gripper with servos of their own.
        begins: Further indices in qpos, of joints that follow others, and their initial values.
        thing: The object.
        thing_qpos: The first index of its pose in qpos.
        boxes: (body, mocap body, geom) of the table's slab and block, and of each obstacle.
        touching: (G, G) bool, contacts of two geoms that count as a touch of the arm.
        bumping: (G, G) bool, contacts of the robot with table, boxes and object.
    """

    model: Any
    data: Any
    arm: tuple[Joint, ...]
    fingers: tuple[Joint, ...]
    begins: tuple[tuple[int, float], ...]
    thing: Thing
    thing_qpos: int
    boxes: tuple[tuple[int, int, int], ...]
    touching: NDArray[numpy.bool_]
    bumping: NDArray[numpy.bool_]


Watch: TypeAlias = Callable[[Model], None]
"""Is called with a model after every command to its servos."""


def build(robot: Robot, arm: int | None, boxes: int, thing: Thing) -> Model:
    """The model in which an arm, or only the base with None, moves, with `boxes` obstacles.

    Other arms are at home. RobotError if an inertia of the robot is impossible.
    """
    mj, held = mujoco(), dict[str, float]()
    for each, posture in zip(robot.arms, robot.home, strict=True):
        held |= dict(zip(each.joint_names, posture.tolist(), strict=True))
    held |= robot.description.held
    moved = [] if arm is None else list(robot.arms[arm].joint_names)
    grip = [] if arm is None else gripper_joints(robot, arm)
    coupled = [] if arm is None else [each for each in followers_of(robot, arm) if each not in grip]
    chain = [*moved, *(joint.name for joint in coupled)]
    bodies = rigid_bodies(robot, {*chain, *(joint.name for joint in grip)}, held)
    servos = servos_of(robot, arm, bodies)
    closed = {joint.name: closed_at(joint, robot) for joint in grip if joint.mimic is None}
    followers = [*coupled, *(joint for joint in grip if joint.mimic is not None)]
    spec = _empty(mj)
    _add_robot(mj, spec, bodies, servos)
    _add_scene(mj, spec, boxes, thing)
    _add_excludes(spec, robot, bodies, chain)
    for joint in followers:
        _add_follower(mj, spec, joint)
    _add_servos(mj, spec, bodies, {name: servos[name] for name in (*moved, *closed)})
    model = spec.compile()
    touching, bumping = _contacts(model, _arm_bodies(bodies, moved), _box_names(boxes))

    def address(joint: str) -> int:
        return int(model.joint(joint).qposadr[0])

    def joint_of(name: str) -> Joint:
        servo = model.actuator(name).id
        stiffness, damping = model.actuator_biasprm[servo, 1:3]
        begin, end = held.get(name, 0.0), closed.get(name, 0.0)
        lag = float(damping / stiffness)
        return Joint(name, address(name), servo, lag, servos[name].speed, begin, end)

    return Model(
        model, mj.MjData(model),
        arm=tuple(joint_of(name) for name in moved),
        fingers=tuple(joint_of(name) for name in closed),
        begins=tuple((address(joint.name), follows(joint, held)) for joint in followers),
        thing=thing, thing_qpos=address("object"),
        boxes=tuple(_box(model, name) for name in _box_names(boxes)),
        touching=touching, bumping=bumping,
    )  # fmt: skip


def _empty(mj: Any) -> Any:
    spec = mj.MjSpec()
    option = spec.option
    option.timestep, option.impratio = TIMESTEP, IMPRATIO
    option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.compiler.degree = False
    spec.compiler.balanceinertia = True
    return spec


def _geom(mj: Any, kind: str) -> Any:
    return getattr(mj.mjtGeom, f"mjGEOM_{kind.upper()}")


def _add_robot(mj: Any, spec: Any, bodies: list[RigidBody], servos: dict[str, Servo]) -> None:
    slide, hinge = mj.mjtJoint.mjJNT_SLIDE, mj.mjtJoint.mjJNT_HINGE
    made = {"": spec.worldbody}
    for body in bodies:
        one = made[body.parent].add_body(name=body.name, gravcomp=1.0)
        made[body.name] = one
        one.pos, one.quat = body.pose[:3, 3], _quaternion(mj, body.pose)
        one.explicitinertial, one.mass, one.ipos = True, body.mass, body.centre
        one.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        if (joint := body.joint) is None:
            for name, kind, axis in zip(BASE, (slide, slide, hinge), numpy.eye(3), strict=True):
                one.add_joint(name=name, type=kind, axis=axis)
        else:
            kind = slide if joint.type == "prismatic" else hinge
            added = one.add_joint(name=joint.name, type=kind, axis=joint.axis)
            added.armature = servos[joint.name].armature
            if joint.type != "continuous":
                added.range = [joint.limit.lower, joint.limit.upper]
        for k, shape in enumerate(body.shapes):
            one.add_geom(
                name=f"{body.name}#{k}", type=_geom(mj, shape.kind), size=_three(shape.size),
                pos=shape.pose[:3, 3], quat=_quaternion(mj, shape.pose), condim=4, mass=0,
                rgba=METAL,
            )  # fmt: skip


def _add_follower(mj: Any, spec: Any, joint: Any) -> None:
    equal = spec.add_equality(
        type=mj.mjtEq.mjEQ_JOINT, objtype=mj.mjtObj.mjOBJ_JOINT,
        name1=joint.name, name2=joint.mimic.joint, solref=[0.01, 1.0],
    )  # fmt: skip
    polynomial = numpy.zeros(len(equal.data))
    polynomial[:2] = mimic_of(joint)
    equal.data = polynomial


def _add_scene(mj: Any, spec: Any, boxes: int, thing: Thing) -> None:
    """Add the floor, the table, obstacles and the object; sizes of boxes are set later."""
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = AMBIENT, DIFFUSE
    spec.worldbody.add_light(**LAMP)
    spec.worldbody.add_geom(
        name="floor", type=_geom(mj, "plane"), size=[0, 0, 1], contype=FLOOR, conaffinity=0,
        rgba=GREY,
    )  # fmt: skip
    for name in _box_names(boxes):
        body = spec.worldbody.add_body(name=name, mocap=True)
        body.add_geom(
            name=name, type=_geom(mj, "box"), size=[1, 1, 1], condim=4,
            rgba=WOOD if name in GROUND else BROWN,
        )  # fmt: skip
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    body.add_geom(
        name="object", type=_geom(mj, thing.kind), size=_three(thing.size), mass=thing.mass,
        condim=4, conaffinity=1 | FLOOR, friction=[thing.friction, 0.01, 0.001], rgba=GREEN,
    )  # fmt: skip


def _arm_bodies(bodies: list[RigidBody], moved: list[str]) -> dict[str, int]:
    """The bodies that the arm moves, by name, and the number of joints from which each hangs."""
    depth = {"": 0}
    for body in bodies:
        depth[body.name] = depth[body.parent] + (body.joint is not None)
    return {body.name: depth[body.name] for body in bodies if body.joint is not None and moved}


def _add_excludes(spec: Any, robot: Robot, bodies: list[RigidBody], moved: list[str]) -> None:
    """Exclude pairs that never collide: adjacent bodies of an arm, and shoulders with the body."""
    depth, base = _arm_bodies(bodies, moved), robot.description.base_frame
    parent = {body.name: body.parent for body in bodies}
    pairs = {(base, name) for name, joints in depth.items() if joints <= SHOULDER}
    for name in depth:
        above = name
        for _ in range(NEIGHBOURS):
            if (above := parent[above]) not in depth:
                break
            pairs.add((above, name))
    body_of = {shape.link: body.name for body in bodies for shape in body.shapes}
    for links in robot.description.excludes:
        first, *others = (body_of.get(robot.urdf.link(link).name, base) for link in links)
        pairs |= {(first, other) for other in others if other != first}
    fingers = [name for name, joints in depth.items() if joints > len(moved)]
    pairs |= {(a, b) for a in fingers for b in fingers if a < b}
    for first, second in sorted(pairs):
        spec.add_exclude(bodyname1=first, bodyname2=second)


def _add_servos(mj: Any, spec: Any, bodies: list[RigidBody], servos: dict[str, Servo]) -> None:
    """Add velocity servos of the base, and position servos of joints with gravity compensation."""

    def add(name: str, limit: float, gain: float, bias: list[float]) -> None:
        servo = spec.add_actuator(name=name, target=name, trntype=mj.mjtTrn.mjTRN_JOINT)
        servo.forcerange = [-limit, limit]
        servo.biastype = mj.mjtBias.mjBIAS_AFFINE
        servo.gainprm[0], servo.biasprm[:3] = gain, bias

    for name, (damping, limit) in zip(BASE, base_servos(bodies), strict=True):
        add(name, limit, damping, [0.0, 0.0, -damping])
    for name, servo in servos.items():  # a positive third number is a damping ratio
        add(name, servo.force, servo.stiffness, [0.0, -servo.stiffness, 1.0])


def _box(model: Any, name: str) -> tuple[int, int, int]:
    body = model.body(name).id
    return body, int(model.body_mocapid[body]), model.geom(name).id


def _contacts(
    model: Any, arm: Collection[str], names: list[str]
) -> tuple[NDArray[numpy.bool_], ...]:
    """(G, G) bool: which contacts count as a touch of the arm, and which as a bump of the robot."""
    bodies = numpy.array([model.body(body).name for body in model.geom_bodyid])
    moves, boxes = numpy.isin(bodies, [*arm]), numpy.isin(bodies, names)
    ground, thing = bodies == "world", bodies == "object"
    touching = moves[:, None] & ~(thing | ground)[None, :]
    bumping = ~(thing | ground | boxes)[:, None] & (thing | boxes)[None, :]
    return touching | touching.T, bumping | bumping.T


def _box_names(obstacles: int) -> list[str]:
    return [*GROUND, *(f"obstacle {k}" for k in range(obstacles))]


def _three(size: tuple[float, ...]) -> list[float]:
    return [*size, 0.0, 0.0][:3]


def _quaternion(mj: Any, pose: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
    out = numpy.empty(4)
    mj.mju_mat2Quat(out, pose[:3, :3].flatten())
    return out
