"""The robot, a table, boxes on the floor and an object as a MuJoCo model.

One model serves all scenes with the same number of boxes; positions and sizes are written into it
before each simulation (`cgtorch.tabletop.physics.scene`). In the model of an arm, this arm, its
gripper and the base move; in the model for driving, only the base does.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy
from numpy.typing import NDArray

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics.bodies import RigidBody, follows, mimic_of, rigid_bodies
from cgtorch.tabletop.physics.engine import mujoco
from cgtorch.tabletop.physics.fingers import closed_at, gripper_joints
from cgtorch.tabletop.physics.gains import Gains, gains_of
from cgtorch.tabletop.physics.thing import Thing

TIMESTEP = 0.005  # s
IMPRATIO = 10.0
FLOOR = 2  # the collision bit of what the floor stops, which the robot stands on anyway
NEIGHBOURS = 2
"""Bodies of an arm with at most this many joints between them do not collide by design."""
SHOULDER = 3
"""Bodies of an arm that hang from at most this many joints do not collide with the robot's body."""
GROUND = ("slab", "block")


@dataclass(frozen=True)
class Joint:
    """A joint with a servo: its name, its indices in qpos and ctrl, and the servo's parameters.

    `lag` is the time, in s, by which the servo's damping delays it behind a moving target. It
    begins at `open` (rad or m), the home position of an arm's joint. A finger grasps by moving to
    `closed`.
    """

    name: str
    qpos: int
    ctrl: int
    lag: float
    open: float
    closed: float


@dataclass(frozen=True)
class Model:
    """A compiled model, and the indices of its parts.

    Attributes:
        model, data: MuJoCo's own.
        arm: Joints of the moving arm, from base to tool.
        fingers: Joints of its gripper with servos of their own.
        begins: Further indices in qpos, of fingers that follow others, and their initial values.
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
    gains: Gains


def build(robot: Robot, arm: int | None, boxes: int, thing: Thing) -> Model:
    """The model in which an arm, or only the base with None, moves, with `boxes` obstacles.

    Other arms are at home. RobotError if a mass or inertia of the robot is impossible.
    """
    mj, home = mujoco(), dict[str, float]()
    for each, posture in zip(robot.arms, robot.home, strict=True):
        home |= dict(zip(each.joint_names, posture.tolist(), strict=True))
    held = {**home, **robot.description.held}
    moved = [] if arm is None else list(robot.arms[arm].joint_names)
    grip = [] if arm is None else gripper_joints(robot, arm)
    bodies = rigid_bodies(robot, {*moved, *(joint.name for joint in grip)}, held)
    gains = gains_of(robot, arm, bodies)
    spec = _empty(mj)
    _add_robot(mj, spec, bodies, gains)
    _add_scene(mj, spec, boxes, thing)
    _add_excludes(spec, robot, bodies, moved)
    fingers = [joint for joint in grip if joint.mimic is None]
    followers = [joint for joint in grip if joint.mimic is not None]
    for joint in followers:
        _add_follower(mj, spec, joint)
    _add_servos(mj, spec, [*moved, *(joint.name for joint in fingers)], gains)
    model = spec.compile()
    touching, bumping = _contacts(model, _arm_bodies(bodies, moved))
    return Model(
        model, mj.MjData(model),
        arm=tuple(_joint(model, name, held.get(name, 0.0), 0.0) for name in moved),
        fingers=tuple(
            _joint(model, joint.name, held.get(joint.name, 0.0), closed_at(joint, robot))
            for joint in fingers
        ),
        begins=tuple(
            (int(model.joint(joint.name).qposadr[0]), follows(joint, held)) for joint in followers
        ),
        thing=thing, thing_qpos=int(model.joint("object").qposadr[0]),
        boxes=tuple(_box(model, name) for name in (*GROUND, *_obstacles(boxes))),
        touching=touching, bumping=bumping, gains=gains,
    )  # fmt: skip


def _empty(mj: Any) -> Any:
    spec = mj.MjSpec()
    option = spec.option
    option.timestep, option.impratio = TIMESTEP, IMPRATIO
    option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.compiler.degree = False
    spec.compiler.balanceinertia = True
    spec.compiler.autolimits = True
    return spec


def _add_robot(mj: Any, spec: Any, bodies: list[RigidBody], gains: Gains) -> None:
    kinds = {
        name: getattr(mj.mjtGeom, f"mjGEOM_{name.upper()}")
        for name in ("sphere", "cylinder", "capsule", "box")
    }
    made = {"": spec.worldbody}
    for body in bodies:
        one = made[body.parent].add_body(name=body.name, gravcomp=1.0)
        made[body.name] = one
        one.pos, one.quat = body.pose[:3, 3], _quaternion(mj, body.pose)
        one.explicitinertial, one.mass, one.ipos = True, body.mass, body.centre
        i = body.inertia
        one.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
        if body.joint is None:
            _add_base(mj, one)
        else:
            _add_joint(mj, one, body.joint, gains)
        for k, shape in enumerate(body.shapes):
            one.add_geom(
                name=f"{body.name}#{k}", type=kinds[shape.kind], size=_three(shape.size),
                pos=shape.pose[:3, 3], quat=_quaternion(mj, shape.pose), condim=4, mass=0,
                contype=1, conaffinity=1, rgba=[0.75, 0.77, 0.8, 1],
            )  # fmt: skip


def _add_base(mj: Any, body: Any) -> None:
    slide, hinge = mj.mjtJoint.mjJNT_SLIDE, mj.mjtJoint.mjJNT_HINGE
    body.add_joint(name="base x", type=slide, axis=[1, 0, 0])
    body.add_joint(name="base y", type=slide, axis=[0, 1, 0])
    body.add_joint(name="base turn", type=hinge, axis=[0, 0, 1])


def _add_joint(mj: Any, body: Any, joint: Any, gains: Gains) -> None:
    kind = mj.mjtJoint.mjJNT_SLIDE if joint.type == "prismatic" else mj.mjtJoint.mjJNT_HINGE
    one = body.add_joint(name=joint.name, type=kind, axis=joint.axis)
    one.armature = gains.armature.get(joint.name, 0.0)
    if joint.type != "continuous":
        one.range = [joint.limit.lower, joint.limit.upper]


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
    box = mj.mjtGeom.mjGEOM_BOX
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.4] * 3, [0.5] * 3
    spec.worldbody.add_light(pos=[0, 0, 4], dir=[0, 0, -1], castshadow=False)
    spec.worldbody.add_geom(
        name="floor", type=mj.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=FLOOR, conaffinity=0,
        rgba=[0.55, 0.56, 0.58, 1],
    )  # fmt: skip
    for name in (*GROUND, *_obstacles(boxes)):
        body = spec.worldbody.add_body(name=name, mocap=True)
        body.add_geom(
            name=name, type=box, size=[1, 1, 1], condim=4, contype=1, conaffinity=1,
            rgba=[0.72, 0.55, 0.38, 1] if name in GROUND else [0.5, 0.35, 0.3, 1],
        )  # fmt: skip
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    kind = getattr(mj.mjtGeom, f"mjGEOM_{thing.kind.upper()}")
    body.add_geom(
        name="object", type=kind, size=_three(thing.size), mass=thing.mass, condim=4,
        contype=1, conaffinity=1 | FLOOR, friction=[thing.friction, 0.01, 0.001],
        rgba=[0.1, 0.55, 0.3, 1],
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
        above, joints = parent[name], 1
        while above in depth:
            if joints <= NEIGHBOURS:
                pairs.add((above, name))
            above, joints = parent[above], joints + 1
    body_of = {shape.link: body.name for body in bodies for shape in body.shapes}
    for links in robot.description.excludes:
        first, *others = (body_of.get(robot.urdf.link(link).name, base) for link in links)
        pairs |= {(first, other) for other in others if other != first}
    fingers = [name for name, joints in depth.items() if joints > len(moved)]
    pairs |= {(a, b) for a in fingers for b in fingers if a < b}
    for first, second in sorted(pairs):
        spec.add_exclude(bodyname1=first, bodyname2=second)


def _add_servos(mj: Any, spec: Any, joints: list[str], gains: Gains) -> None:
    """Add velocity servos of the base, and position servos of joints with gravity compensation."""
    limits = (gains.base_force, gains.base_force, gains.base_torque)
    for name, damping, limit in zip(
        ("base x", "base y", "base turn"), gains.base_damping, limits, strict=True
    ):
        servo = spec.add_actuator(name=name, target=name, trntype=mj.mjtTrn.mjTRN_JOINT)
        servo.set_to_velocity(kv=damping)
        servo.forcerange = [-limit, limit]
    for name in joints:
        servo = spec.add_actuator(name=name, target=name, trntype=mj.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=gains.stiffness[name], dampratio=1.0)
        servo.forcerange = [-gains.force[name], gains.force[name]]


def _joint(model: Any, name: str, begin: float, closed: float) -> Joint:
    servo = model.actuator(name).id
    stiffness, damping = model.actuator_biasprm[servo, 1:3]
    lag = float(damping / stiffness)
    return Joint(name, int(model.joint(name).qposadr[0]), servo, lag, begin, closed)


def _box(model: Any, name: str) -> tuple[int, int, int]:
    body = model.body(name).id
    return body, int(model.body_mocapid[body]), model.geom(name).id


def _contacts(model: Any, arm: Collection[str]) -> tuple[NDArray[numpy.bool_], ...]:
    """(G, G) bool: which contacts count as a touch of the arm, and which as a bump of the robot."""
    bodies = [model.body(body).name for body in model.geom_bodyid]
    moves = numpy.array([name in arm for name in bodies])
    ground = numpy.array([name == "world" for name in bodies])
    thing = numpy.array([name == "object" for name in bodies])
    boxes = numpy.array([name in GROUND or name.startswith("obstacle ") for name in bodies])
    touching = moves[:, None] & ~(thing | ground)[None, :]
    bumping = ~(thing | ground | boxes)[:, None] & (thing | boxes)[None, :]
    return touching | touching.T, bumping | bumping.T


def _obstacles(count: int) -> list[str]:
    return [f"obstacle {k}" for k in range(count)]


def _three(size: tuple[float, ...]) -> list[float]:
    return [*size, 0.0, 0.0][:3]


def _quaternion(mj: Any, pose: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
    out = numpy.zeros(4)
    mj.mju_mat2Quat(out, pose[:3, :3].flatten())
    return out / math.sqrt(float(out @ out))
