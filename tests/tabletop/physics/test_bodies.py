"""Merged links are where the library's own kinematics have them, and weigh what the URDF says."""

import json
import shutil
from pathlib import Path

import mujoco
import numpy
import pytest
import torch
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import Robot, load_robot, robots_folder
from cgtorch.tabletop.physics import Physics, Thing
from cgtorch.tabletop.physics.bodies import rigid_bodies
from cgtorch.tabletop.physics.model import build
from cgtorch.tabletop.physics.scene import Scene, put


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
            for joint, value in zip(model.arm, posture.tolist(), strict=True):
                model.data.qpos[joint.qpos] = value
            mujoco.mj_kinematics(model.model, model.data)
            for joint in arm.joint_names:
                link = robot.urdf.joint(joint).child
                body = model.model.body(link).id
                expected = frames[chain.frame_to_idx[link], row]
                assert numpy.allclose(model.data.xpos[body], expected[:3, 3], atol=1e-9)
                assert numpy.allclose(
                    model.data.xmat[body].reshape(3, 3), expected[:3, :3], atol=1e-9
                )


@pytest.mark.parametrize("moving", [(), ("l_elbow_flex_joint", "l_wrist_roll_joint")])
def test_merging_links_keeps_their_mass(robot: Robot, moving: tuple[str, ...]) -> None:
    root = etree.fromstring(robot.urdf.xml)
    total = sum(float(mass.get("value")) for mass in root.iter("mass"))
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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="25.8"', 'value="nan"', "line 118: mass value is 'nan'"),
        ('value="25.8"', 'value="1e30"', "mass value is '1e30'"),
        ('value="25.8"', 'value="-1"', "l_shoulder_pan_link.*mass -1"),
        ('ixx="0.2982" ixy="0"', 'ixx="inf" ixy="0"', "line 119: inertia ixx is 'inf'"),
        ('ixx="0.2982" ixy="0"', 'ixx="0.2982" ixy="9"', "l_shoulder_pan_link.*inertia of -8"),
    ],
)
def test_masses_that_cannot_be_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (robots_folder() / "pr2" / "pr2.urdf").read_text()
    at = text.index('<link name="l_shoulder_pan_link"')
    shutil.copy(robots_folder() / "pr2" / "robot.json", tmp_path)
    (tmp_path / "pr2.urdf").write_text(text[:at] + text[at:].replace(old, new, 1))
    with pytest.raises(RobotError, match=message):
        build(load_robot(tmp_path / "pr2.urdf"), 0, 0, Thing())


def test_links_without_mass_or_inertia_are_simulated(tmp_path: Path) -> None:
    text = (robots_folder() / "pr2" / "pr2.urdf").read_text()
    at = text.index('<link name="l_shoulder_pan_link"')
    shutil.copy(robots_folder() / "pr2" / "robot.json", tmp_path)
    for old, new in (('value="25.8"', 'value="0"'), ('ixx="0.2982"', 'ixx="0"')):
        (tmp_path / "pr2.urdf").write_text(text[:at] + text[at:].replace(old, new, 1))
        model = build(load_robot(tmp_path / "pr2.urdf"), 0, 0, Thing())
        assert (model.model.body_inertia[1:] >= 0).all()
        assert numpy.isfinite(model.model.body_inertia).all()


def test_an_inertia_that_cannot_be_is_named(tmp_path: Path) -> None:
    text = (robots_folder() / "pr2" / "pr2.urdf").read_text()
    broken = text.replace('ixx="0.2982"', 'ixx="-0.2982"', 1)
    folder = tmp_path
    (folder / "pr2.urdf").write_text(broken)
    words = (robots_folder() / "pr2" / "robot.json").read_text()
    (folder / "robot.json").write_text(words)
    with pytest.raises(RobotError, match=r"l_shoulder_pan_link.*has an inertia of -0.298"):
        Physics(load_robot(None, folder)).model(None, 0)


def test_an_exclude_of_a_missing_link_is_named(tmp_path: Path) -> None:
    folder = tmp_path
    (folder / "pr2.urdf").write_text((robots_folder() / "pr2" / "pr2.urdf").read_text())
    words = json.loads((robots_folder() / "pr2" / "robot.json").read_text())
    words["excludes"] = [["base_link", "no_link"]]
    (folder / "robot.json").write_text(json.dumps(words))
    with pytest.raises(RobotError, match="no link 'no_link'"):
        Physics(load_robot(None, folder)).model(0, 0)
