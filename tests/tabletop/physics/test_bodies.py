"""Merged links are where the library's own kinematics have them, and weigh what the URDF says."""

import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy
import pytest
import torch
from lxml import etree
from scipy.spatial.transform import Rotation
from yourdfpy.urdf import Inertial, Joint, Limit, Link, Mimic

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import Robot, load_robot, robots_folder
from cgtorch.tabletop.physics import Physics, Thing
from cgtorch.tabletop.physics.bodies import (
    ARMATURE,
    BASE_DAMPING,
    BASE_FORCE,
    EFFORT,
    FINGER,
    FINGER_ARMATURE,
    GRIP,
    LEAST_INERTIA,
    LEAST_MASS,
    SLIDING,
    SPEED,
    STIFFNESS,
    TURN_DAMPING,
    TURN_FORCE,
    RigidBody,
    _capsule,
    _mass,
    _motion,
    _shapes,
    base_servos,
    closed_at,
    gripper_joints,
    limit_of,
    mimic_of,
    rigid_bodies,
    servos_of,
)
from cgtorch.tabletop.physics.model import build
from cgtorch.tabletop.physics.scene import Scene, put

PR2 = robots_folder() / "pr2"


@pytest.mark.parametrize("name", ["pr2", "fetch"])
def test_bodies_are_where_the_library_has_its_frames(name: str) -> None:
    robot = load_robot(None, name)
    for which, arm in enumerate(robot.arms):
        model = build(robot, which, 0, Thing())
        generator = torch.Generator().manual_seed(which)
        low = torch.where(arm.continuous, -3.0, arm.lower)
        high = torch.where(arm.continuous, 3.0, arm.upper)
        q = low + (high - low) * torch.rand(20, len(low), generator=generator, dtype=low.dtype)
        frames, chain = arm.frames(q), arm.chain(q)[0]
        for row, posture in enumerate(q):
            model.data.qpos[[joint.qpos for joint in model.arm]] = posture
            mujoco.mj_kinematics(model.model, model.data)
            for joint in arm.joint_names:
                link = robot.urdf.joint(joint).child
                body = model.model.body(link).id
                pose = numpy.eye(4)
                pose[:3, :3], pose[:3, 3] = (
                    model.data.xmat[body].reshape(3, 3),
                    model.data.xpos[body],
                )
                assert numpy.allclose(pose, frames[chain.frame_to_idx[link], row], atol=1e-9)


@pytest.mark.parametrize("moving", [(), ("l_elbow_flex_joint", "l_wrist_roll_joint")])
def test_merging_links_keeps_their_mass(robot: Robot, moving: tuple[str, ...]) -> None:
    total = sum(float(mass.get("value")) for mass in etree.fromstring(robot.urdf.xml).iter("mass"))
    bodies = rigid_bodies(robot, moving, robot.description.held)
    assert len(bodies) == 1 + len(moving)
    assert sum(body.mass for body in bodies) == pytest.approx(total)
    assert all(numpy.linalg.eigvalsh(body.inertia).min() > 0 for body in bodies)


def test_merged_inertia_is_that_of_the_parts(robot: Robot) -> None:
    """The moment about the base's axis does not depend on how links are merged."""
    model = build(robot, 0, 0, Thing())
    data = put(model, Scene.of(numpy.array([0.0] * 12 + [1, 0, 0, 0])))
    turn, moment = (numpy.zeros(model.model.nv) for _ in range(2))
    turn[2] = 1
    mujoco.mj_mulM(model.model, data, moment, turn)
    held = dict(robot.description.held)
    for arm, posture in zip(robot.arms, robot.home, strict=True):
        held |= dict(zip(arm.joint_names, posture.tolist(), strict=True))
    whole = rigid_bodies(robot, (), held)[0]
    about = whole.inertia[2, 2] + whole.mass * (whole.centre[:2] @ whole.centre[:2])
    assert moment[2] == pytest.approx(about, rel=1e-3)


def changed(folder: Path, old: str, new: str) -> Path:
    """A PR2 in which something of its left shoulder, or what follows it, is replaced once."""
    text = (PR2 / "pr2.urdf").read_text()
    at = text.index('<link name="l_shoulder_pan_link"')
    shutil.copy(PR2 / "robot.json", folder)
    (folder / "pr2.urdf").write_text(text[:at] + text[at:].replace(old, new, 1))
    return folder / "pr2.urdf"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="25.8"', 'value="nan"', "line 118: mass value is 'nan'"),
        ('value="25.8"', 'value="1e30"', "mass value is '1e30'"),
        ('value="25.8"', 'value="-1"', "l_shoulder_pan_link.*mass -1"),
        ('ixx="0.2982" ixy="0"', 'ixx="inf" ixy="0"', "line 119: inertia ixx is 'inf'"),
        ('ixx="0.2982" ixy="0"', 'ixx="0.2982" ixy="9"', "l_shoulder_pan_link.*inertia of -8"),
        ('ixx="0.2982"', 'ixx="-0.2982"', "l_shoulder_pan_link.*has an inertia of -0.298"),
        ('ixx="0.2982"', 'ixx="-1e-7"', "has an inertia with the diagonal.*give principal"),
    ],
)
def test_masses_that_cannot_be_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        build(load_robot(changed(tmp_path, old, new)), 0, 0, Thing())


@pytest.mark.parametrize("what", ['value="25.8"', 'ixx="0.2982"'])
def test_links_without_mass_or_inertia_are_simulated(tmp_path: Path, what: str) -> None:
    urdf = changed(tmp_path, what, f'{what.partition("=")[0]}="0"')
    inertia = build(load_robot(urdf), 0, 0, Thing()).model.body_inertia
    assert (inertia[1:] >= 0).all()
    assert numpy.isfinite(inertia).all()


def test_an_exclude_of_a_missing_link_is_named(tmp_path: Path) -> None:
    urdf = changed(tmp_path, "", "")
    words = json.loads((PR2 / "robot.json").read_text())
    words["excludes"] = [["base_link", "no_link"]]
    (tmp_path / "robot.json").write_text(json.dumps(words))
    with pytest.raises(RobotError, match="no link 'no_link'"):
        Physics(load_robot(urdf)).model(0, 0)


def placed(name: str, mass: float, inertia: object, x: float) -> Any:
    """A link with a mass at x."""
    origin, pose = numpy.eye(4), numpy.eye(4)
    pose[0, 3] = x
    return Link(name, inertial=Inertial(origin=origin, mass=mass, inertia=inertia)), pose


def test_two_masses_at_a_distance_have_the_moments_of_a_dumbbell() -> None:
    """A link of which no inertia is told is a point; one without mass counts for nothing."""
    moments = numpy.diag([0.1, 0.2, 0.3])
    parts = [placed("one", 3.0, None, 0.0), placed("two", 1.0, moments, 4.0)]
    none = [(Link("none", inertial=None), numpy.eye(4)), placed("light", 0.0, moments, 9.0)]
    mass, centre, inertia = _mass([*parts, *none])
    assert mass == 4.0
    assert centre.tolist() == [1.0, 0.0, 0.0]
    reduced = 3.0 * 1.0 / 4.0 * 4.0**2
    wanted = [0.1, 0.2 + reduced, 0.3 + reduced]
    assert inertia.diagonal() == pytest.approx(wanted, abs=1e-3)
    assert numpy.allclose(inertia, numpy.diag(inertia.diagonal()))


def test_a_body_without_mass_has_the_least_that_can_be_simulated() -> None:
    mass, centre, inertia = _mass([])
    assert mass == LEAST_MASS
    assert centre.tolist() == [0.0] * 3
    assert numpy.array_equal(inertia, LEAST_INERTIA * numpy.eye(3))


def test_fingers_close_to_the_limit_farther_from_where_they_are_held(robot: Robot) -> None:
    """Others, and those that turn without limits, stay."""
    fingers = gripper_joints(robot, 0)
    assert fingers
    for joint in fingers:
        held = robot.description.held.get(joint.name)
        at = closed_at(joint, robot)
        if held is None:
            assert at == 0.0
        else:
            ends = float(joint.limit.lower), float(joint.limit.upper)
            assert at in ends
            assert abs(at - held) == max(abs(end - held) for end in ends)
    turning = Joint("free", type="continuous", limit=None)
    assert closed_at(turning, robot) == 0.0


@pytest.mark.parametrize(
    ("value", "found"), [(None, 7.0), (0.0, 7.0), (-1.0, 7.0), (1e6, 7.0), (3.0, 3.0), (0.5, 0.5)]
)
def test_a_limit_that_says_nothing_is_the_usual_one(value: float | None, found: float) -> None:
    joint = Joint("any", type="revolute", limit=Limit(effort=value, velocity=2.0))
    assert limit_of(joint, "effort", 7.0) == found
    assert limit_of(joint, "velocity", 7.0) == 2.0
    assert limit_of(Joint("any", type="revolute", limit=None), "effort", 7.0) == 7.0


def moved_by(joint: Joint | None, mass: float = 1.0, turning: float = 0.0) -> RigidBody:
    """A body that hangs from a joint, and whose centre of mass is 5 m from its axis."""
    inertia = numpy.diag([9.0, 9.0, turning])
    centre, pose = numpy.array([3.0, 4.0, 7.0]), numpy.eye(4)
    return RigidBody("body", "", pose, joint, (), mass, centre, inertia)


def test_servos_become_weaker_along_an_arm_and_fingers_have_their_own() -> None:
    limit = Limit(effort=100.0, velocity=2.0)
    joints = [
        Joint("first", type="revolute"),
        Joint("middle", type="prismatic", limit=limit),
        Joint("last", type="continuous", limit=limit),
        Joint("turns", type="revolute", limit=limit),
        Joint("slides", type="prismatic", limit=limit),
        Joint("weak", type="prismatic", limit=Limit(effort=4.0, velocity=2.0)),
    ]
    arm = SimpleNamespace(joint_names=("first", "middle", "last"))
    robot: Any = SimpleNamespace(arms=[arm], description=SimpleNamespace(gains={"last": 7.0}))
    servos = servos_of(robot, 0, [moved_by(joint) for joint in (None, *joints)])
    assert servos["first"] == (STIFFNESS[0], EFFORT, SPEED, ARMATURE[0])
    between = [math.sqrt(ends[0] * ends[1]) for ends in (STIFFNESS, ARMATURE)]
    middle = between[0] * SLIDING, 100.0, 2.0, between[1]
    assert servos["middle"] == pytest.approx(middle)
    assert servos["last"] == (7.0, 100.0, 2.0, pytest.approx(ARMATURE[1]))
    assert servos["turns"] == (FINGER[0], GRIP[0], 2.0, FINGER_ARMATURE[0])
    assert servos["slides"] == (FINGER[1], GRIP[1], 2.0, FINGER_ARMATURE[1])
    assert servos["weak"] == (FINGER[1], 4.0, 2.0, FINGER_ARMATURE[1])
    assert servos_of(robot, None, [moved_by(joints[0])])["first"].stiffness == FINGER[0]
    arm.joint_names = ("first",)
    assert servos_of(robot, 0, [moved_by(joints[0])])["first"].stiffness == STIFFNESS[0]


def test_the_base_is_moved_by_its_mass_and_turned_by_its_moment() -> None:
    sliding, other, turning = base_servos([moved_by(None, 2.0, 4.0), moved_by(None, 6.0)])
    assert sliding == other == (BASE_DAMPING * 8.0, BASE_FORCE * 8.0)
    assert turning == (TURN_DAMPING * 54.0, TURN_FORCE * 54.0)
    light = base_servos([moved_by(None, 0.01, 0.1)])[2]
    assert light == (TURN_DAMPING, TURN_FORCE)


def placed_at(x: float) -> Any:
    """A pose that is turned about z by a quarter, at x."""
    pose = numpy.eye(4)
    pose[:2, :2], pose[0, 3] = [[0.0, -1.0], [1.0, 0.0]], x
    return pose


@pytest.mark.parametrize("end", [(0.3, 0.0, 0.0), (0.0, 0.0, -0.2), (0.1, 0.2, 0.3)])
def test_a_capsule_lies_along_z_of_its_own_pose(end: tuple[float, ...]) -> None:
    row = numpy.array([0.1, 0.0, 0.5, 0.1 + end[0], end[1], 0.5 + end[2], 0.05])
    found = _capsule("link", row, placed_at(2.0))
    length = math.hypot(*end)
    assert (found.link, found.kind) == ("link", "capsule")
    assert found.size == pytest.approx((0.05, length / 2))
    turn = found.pose[:3, :3]
    assert turn @ turn.T == pytest.approx(numpy.eye(3))
    assert numpy.linalg.det(turn) == pytest.approx(1)
    assert turn[:, 2] * length == pytest.approx([-end[1], end[0], end[2]])
    middle = [0.1 + end[0] / 2, end[1] / 2, 0.5 + end[2] / 2]
    assert found.pose[:3, 3] == pytest.approx([2 - middle[1], middle[0], middle[2]])


def test_a_capsule_without_length_is_a_sphere() -> None:
    found = _capsule("link", numpy.array([0.1, 0, 0, 0.1, 0, 0, 0.05]), placed_at(2.0))
    assert (found.kind, found.size) == ("sphere", (0.05,))
    assert found.pose[:3, 3].tolist() == pytest.approx([2.0, 0.1, 0.0])


def test_shapes_have_half_sizes_and_those_without_size_are_left_out() -> None:
    def shape(**kinds: object) -> Any:
        every = {"sphere": None, "cylinder": None, "box": None, **kinds}
        return SimpleNamespace(origin=placed_at(1.0), geometry=SimpleNamespace(**every))

    link = SimpleNamespace(name="link", collisions=[
        shape(sphere=SimpleNamespace(radius=0.3)), shape(box=SimpleNamespace(size=(0.2, 0.4, 0.6))),
        shape(cylinder=SimpleNamespace(radius=0.1, length=0.6)), shape(),
        shape(sphere=SimpleNamespace(radius=0.0)), shape(box=SimpleNamespace(size=(0.2, 0.0, 0.6))),
    ])  # fmt: skip
    robot: Any = SimpleNamespace(description=SimpleNamespace(capsules={}))
    found = _shapes(robot, link, placed_at(2.0))
    assert [(each.kind, each.size) for each in found] == [
        ("sphere", (0.3,)), ("box", (0.1, 0.2, 0.3)), ("cylinder", (0.1, 0.3))
    ]  # fmt: skip
    for each in found:
        assert each.pose == pytest.approx(placed_at(2.0) @ placed_at(1.0))
    robot.description.capsules = {"link": [(0, 0, 0, 0, 0, 1, 0.1), (0, 0, 0, 0, 0, 0, 0.2)]}
    kinds = [each.kind for each in _shapes(robot, link, placed_at(2.0))]
    assert kinds == ["capsule", "sphere"]


def test_a_joint_that_is_held_moves_what_it_carries() -> None:
    follower = Mimic(joint="leader", multiplier=-2.0, offset=0.5)
    axis = numpy.array([0.6, 0.0, 0.8])
    held = {"own": 0.7, "leader": 0.3}
    for kind, mimic, value in (
        ("revolute", None, 0.7), ("continuous", None, 0.7), ("revolute", follower, -0.1),
        ("prismatic", None, 0.7), ("fixed", None, 0.0),
    ):  # fmt: skip
        found = _motion(Joint("own", type=kind, axis=axis, mimic=mimic), held)
        wanted = numpy.eye(4)
        if kind == "prismatic":
            wanted[:3, 3] = value * axis
        else:
            wanted[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
        assert found == pytest.approx(wanted)
    assert _motion(Joint("other", type="prismatic", axis=axis), held) == pytest.approx(numpy.eye(4))
    assert mimic_of(Joint("a", mimic=Mimic(joint="b", multiplier=None, offset=None))) == (0.0, 1.0)
