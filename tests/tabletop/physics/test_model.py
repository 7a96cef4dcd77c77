"""The compiled model: what is in it, what collides with what, and what moves each joint."""

import math

import mujoco
import numpy as np
import pytest

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics import Thing
from cgtorch.tabletop.physics.bodies import (
    RigidBody,
    base_servos,
    closed_at,
    gripper_joints,
    mimic_of,
    rigid_bodies,
    servos_of,
)
from cgtorch.tabletop.physics.model import (
    AMBIENT,
    BASE,
    DIFFUSE,
    FLOOR,
    IMPRATIO,
    NEIGHBOURS,
    SHOULDER,
    TIMESTEP,
    Model,
    build,
)

BOX = Thing("box", (0.02, 0.03, 0.05), 0.3, 0.7)


@pytest.fixture(scope="module")
def model(robot: Robot) -> Model:
    """One whose left arm moves, with two obstacles and a box as object."""
    return build(robot, 0, 2, BOX)


@pytest.fixture(scope="module")
def names(model: Model) -> list[str]:
    """The body of each geom."""
    return [model.model.body(body).name for body in model.model.geom_bodyid]


def bodies_of(robot: Robot) -> list[RigidBody]:
    """The bodies of the robot whose left arm moves, with its other arm at home."""
    held = dict(robot.description.held)
    for arm, posture in zip(robot.arms, robot.home, strict=True):
        held |= dict(zip(arm.joint_names, posture.tolist(), strict=True))
    moving = {*robot.arms[0].joint_names, *(joint.name for joint in gripper_joints(robot, 0))}
    return rigid_bodies(robot, moving, held)


def test_how_it_is_simulated(model: Model) -> None:
    option = model.model.opt
    assert (option.timestep, option.impratio) == (TIMESTEP, IMPRATIO)
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.thing is BOX
    assert BOX.half_height == 0.05


def test_the_object_has_its_shape_mass_and_friction(model: Model) -> None:
    geom, body = model.model.geom("object"), model.model.body("object")
    assert geom.type == mujoco.mjtGeom.mjGEOM_BOX
    assert geom.size.tolist() == [0.02, 0.03, 0.05]
    assert geom.friction.tolist() == [0.7, 0.01, 0.001]
    assert body.mass == 0.3
    assert model.model.body_gravcomp[body.id] == 0
    assert (geom.condim, geom.contype, geom.conaffinity) == (4, 1, 1 | FLOOR)
    assert model.thing_qpos == model.model.joint("object").qposadr[0]


def test_the_floor_stops_the_object_alone(model: Model) -> None:
    floor = model.model.geom("floor")
    assert floor.type == mujoco.mjtGeom.mjGEOM_PLANE
    assert (floor.contype, floor.conaffinity) == (FLOOR, 0)
    assert floor.size[:2].tolist() == [0, 0]  # it has no end
    assert floor.size[2] > 0


def test_a_scene_is_lit_from_above_without_shadows_and_its_parts_have_colours(model: Model) -> None:
    m = model.model
    assert m.light_pos.tolist() == [[0, 0, 4]]
    assert m.light_dir.tolist() == [[0, 0, -1]]
    assert not m.light_castshadow.any()
    assert m.vis.headlight.ambient.tolist() == pytest.approx(AMBIENT)
    assert m.vis.headlight.diffuse.tolist() == pytest.approx(DIFFUSE)
    robot = m.geom_rgba[m.body_gravcomp[m.geom_bodyid] == 1]
    assert (robot == robot[0]).all()
    slab, block, box, other, floor, thing = (
        m.geom(name).rgba.tolist()
        for name in ("slab", "block", "obstacle 0", "obstacle 1", "floor", "object")
    )
    assert slab == block
    assert box == other
    colours = {tuple(each) for each in (robot[0].tolist(), slab, box, floor, thing)}
    assert len(colours) == 5
    assert (m.geom_rgba[:, 3] == 1).all()


def test_shapes_of_the_robot_collide_and_weigh_nothing_themselves(
    model: Model, names: list[str], robot: Robot
) -> None:
    m = model.model
    mine = [geom for geom, body in enumerate(m.geom_bodyid) if m.body_gravcomp[body] == 1]
    others = {"world", "object", "slab", "block", "obstacle 0", "obstacle 1"}
    assert {names[geom] for geom in mine} == {*names} - others
    for geom in mine:
        assert (m.geom_condim[geom], m.geom_contype[geom], m.geom_conaffinity[geom]) == (4, 1, 1)
    for body in bodies_of(robot):
        assert m.body(body.name).mass[0] == pytest.approx(body.mass)
        assert m.body(body.name).ipos == pytest.approx(body.centre)
        if body.joint is not None:
            joint = m.joint(body.joint.name)
            slides = body.joint.type == "prismatic"
            kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
            assert joint.type == kind
            assert joint.axis == pytest.approx(np.array(body.joint.axis))
            limited = body.joint.type != "continuous"
            assert bool(m.jnt_limited[joint.id]) == limited
            if limited:
                limit = body.joint.limit
                assert joint.range == pytest.approx([limit.lower, limit.upper])


def test_boxes_are_moved_by_hand(model: Model, names: list[str]) -> None:
    known = ["slab", "block", "obstacle 0", "obstacle 1"]
    assert [names[geom] for _, _, geom in model.boxes] == known
    m = model.model
    for name, (body, mocap, geom) in zip(known, model.boxes, strict=True):
        assert m.body(body).name == name
        assert m.body_mocapid[body] == mocap
        assert m.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
        assert (m.geom_condim[geom], m.geom_contype[geom], m.geom_conaffinity[geom]) == (4, 1, 1)
    assert sorted(mocap for _, mocap, _ in model.boxes) == [0, 1, 2, 3]


def test_joints_begin_at_home_and_are_moved_by_their_servos(model: Model, robot: Robot) -> None:
    m, grip = model.model, gripper_joints(robot, 0)
    bodies = bodies_of(robot)
    servos = servos_of(robot, 0, bodies)
    assert tuple(joint.name for joint in model.arm) == robot.arms[0].joint_names
    assert [joint.open for joint in model.arm] == robot.home[0].tolist()
    assert {joint.closed for joint in model.arm} == {0.0}
    leading = [joint for joint in grip if joint.mimic is None]
    assert [joint.name for joint in model.fingers] == [joint.name for joint in leading]
    assert [joint.closed for joint in model.fingers] == [closed_at(j, robot) for j in leading]
    held = robot.description.held
    assert [joint.open for joint in model.fingers] == [held.get(j.name, 0.0) for j in leading]
    for joint in (*model.arm, *model.fingers):
        servo, actuator = servos[joint.name], m.actuator(joint.name)
        assert (joint.qpos, joint.ctrl) == (m.joint(joint.name).qposadr[0], actuator.id)
        assert actuator.forcerange.tolist() == [-servo.force, servo.force]
        assert actuator.gainprm[0] == servo.stiffness == -actuator.biasprm[1]
        assert joint.lag == pytest.approx(actuator.biasprm[2] / actuator.biasprm[1])
        mass = m.dof_M0[m.joint(joint.name).dofadr[0]]
        critical = 2 * math.sqrt(servo.stiffness * mass)  # so that it does not swing
        assert joint.lag == pytest.approx(critical / servo.stiffness)
        assert joint.speed == servo.speed
        assert m.joint(joint.name).damping[0] >= 0
        assert m.dof_armature[m.joint(joint.name).dofadr[0]] == servo.armature
    for name, (damping, limit) in zip(BASE, base_servos(bodies), strict=True):
        actuator = m.actuator(name)
        assert actuator.forcerange == pytest.approx([-limit, limit])
        assert actuator.gainprm[0] == pytest.approx(damping)
        assert actuator.biasprm[:3] == pytest.approx([0, 0, -damping])


def test_fingers_follow_others_as_the_urdf_says(model: Model, robot: Robot) -> None:
    m = model.model
    followers = [joint for joint in gripper_joints(robot, 0) if joint.mimic is not None]
    assert followers
    assert m.neq == len(followers) == len(model.begins)
    for number, joint in enumerate(followers):
        assert m.eq_type[number] == mujoco.mjtEq.mjEQ_JOINT
        assert m.eq_obj1id[number] == m.joint(joint.name).id
        assert m.eq_obj2id[number] == m.joint(joint.mimic.joint).id
        assert m.eq_solref[number].tolist() == [0.01, 1.0]  # s, and without swinging
        offset, factor = mimic_of(joint)
        assert m.eq_data[number, :5].tolist() == [offset, factor, 0, 0, 0]
        at = robot.description.held.get(joint.mimic.joint, 0.0)
        begin = m.joint(joint.name).qposadr[0], pytest.approx(offset + factor * at)
        assert model.begins[number] == begin


def test_what_counts_as_a_touch_and_as_a_bump(model: Model, names: list[str], robot: Robot) -> None:
    first = {name: names.index(name) for name in names}
    arm = robot.urdf.joint(robot.arms[0].joint_names[-1]).child
    base = robot.description.base_frame
    for one, other, touches, bumps in (
        (arm, "slab", True, True), (arm, "obstacle 1", True, True), (arm, base, True, False),
        (arm, "object", False, True), (arm, "world", False, False), (base, "block", False, True),
        (base, "object", False, True), (base, "world", False, False),
        ("object", "slab", False, False), ("slab", "block", False, False),
    ):  # fmt: skip
        pairs = (first[one], first[other]), (first[other], first[one])
        assert [bool(model.touching[pair]) for pair in pairs] == [touches] * 2, (one, other)
        assert [bool(model.bumping[pair]) for pair in pairs] == [bumps] * 2, (one, other)


def test_neighbours_and_shoulders_do_not_collide(model: Model, robot: Robot) -> None:
    m, base = model.model, robot.description.base_frame
    halves = [(int(both) >> 16, int(both) & 0xFFFF) for both in m.exclude_signature]
    apart = {frozenset((m.body(a).name, m.body(b).name)) for a, b in halves}
    links = [robot.urdf.joint(joint).child for joint in robot.arms[0].joint_names]
    for i, link in enumerate(links):
        assert (frozenset((base, link)) in apart) == (i < SHOULDER)
        for k, other in enumerate(links[:i]):
            assert (frozenset((other, link)) in apart) == (i - k <= NEIGHBOURS)
    fingers = [joint.child for joint in gripper_joints(robot, 0)]
    assert all(frozenset((a, b)) in apart for a in fingers for b in fingers if a != b)
    assert frozenset((base, fingers[0])) not in apart


def test_without_an_arm_only_the_base_moves(robot: Robot) -> None:
    alone = build(robot, None, 0, Thing())
    assert alone.arm == alone.fingers == alone.begins == ()
    assert not alone.touching.any()
    assert alone.bumping.any()
    assert alone.model.nu == 3
