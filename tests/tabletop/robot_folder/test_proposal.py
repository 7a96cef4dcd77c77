"""What is proposed of a robot: the built-in ones as they are described, and those made for it."""

from types import SimpleNamespace

import mesh_robot
import numpy as np
import pytest
from small_urdfs import box, chain, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_robot, load_urdf, robots_folder
from cgtorch.tabletop.kinematics.description import Arm
from cgtorch.tabletop.kinematics.fitted import without_meshes
from cgtorch.tabletop.robot_folder.proposal import (
    Wishes,
    _body,
    _footprint,
    _names,
    _side,
    _torso_position,
    propose,
)
from cgtorch.tabletop.robot_folder.structure import Structure


def proposed(text, tmp_path, wishes=None):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return propose(load_urdf(path), wishes or Wishes())


@pytest.mark.parametrize("name", ["pr2", "fetch"])
def test_a_built_in_robot_is_seen_as_it_is_described(name):
    known = load_robot(description=name).description
    words = propose(load_urdf(robots_folder() / name / f"{name}.urdf"), Wishes()).words
    assert words.base_frame == known.base_frame
    assert {(arm.base_link, arm.tool_frame) for arm in words.arms} == {
        (arm.base_link, arm.tool_frame) for arm in known.arms
    }
    assert {arm.name for arm in words.arms} == {arm.name for arm in known.arms}
    np.testing.assert_allclose(words.footprint, known.footprint, atol=0.005)
    assert words.torso_joint == known.torso_joint
    assert words.torso_position == pytest.approx(known.torso_position, abs=0.06)
    assert set(known.body) <= set(words.body)
    assert {k for k, v in known.gripper_joints.items() if v} <= set(words.gripper_joints)


FRONT = "0.2 0 0.5"


def test_a_robot_above_the_floor_gets_a_frame_on_it_and_legs_are_no_arms(tmp_path):
    text = (
        f'<robot name="walker"><link name="pelvis">{box("0.3 0.3 0.2")}</link>'
        + chain("arm", 6, "pelvis", first=FRONT)
        + chain("left_leg", 6, "pelvis", "0 0 -0.12", "0 0.1 -0.2")
        + chain("right_leg", 6, "pelvis", "0 0 -0.12", "0 -0.1 -0.2")
        + "</robot>"
    )
    found = proposed(text, tmp_path)
    assert [arm.base_link for arm in found.words.arms] == ["pelvis"]
    assert found.words.base_frame == "base_footprint"
    height = found.urdf.model.get_transform("pelvis", "base_footprint")[2, 3]
    assert height == pytest.approx(0.2 + 5 * 0.12 + 0.025)
    assert any("has no fingers" in note for note in found.notes)
    assert any("was added there" in note for note in found.notes)


def test_a_frame_of_the_world_is_left_out(tmp_path):
    fixed = (
        '<joint name="hold" type="fixed"><parent link="world"/><child link="stand"/></joint>'
        f'<link name="world"/><link name="stand">{box("0.2 0.2 1")}</link>'
    )
    found = proposed(
        f'<robot name="x">{fixed}{chain("a", 6, "stand", first=FRONT)}</robot>', tmp_path
    )
    assert found.words.base_frame == "base_footprint"
    assert "world" not in found.urdf.model.link_map
    assert found.words.footprint == (-0.1, 0.1, -0.1, 0.1)
    assert found.words.torso_joint is None


def test_no_arm_is_said_with_what_to_do(tmp_path):
    text = f'<robot name="x"><link name="a">{box("1 1 1")}</link>{chain("b", 3, "a")}</robot>'
    with pytest.raises(RobotError, match=r"no chain of 4 joints or more.*--arm NAME=BASE"):
        proposed(text, tmp_path)
    wish = Wishes(arms=(Arm("short", "a", "b2"),))
    assert proposed(text, tmp_path, wish).words.arms == wish.arms


def test_an_arm_that_is_said_to_begin_above_the_base_frame_begins_there(tmp_path):
    root = link("world", "") + link("base", box("0.3 0.3 1", "0 0 0.5"))
    root += joint("base", "world", "0 0 0", kind="fixed", more="")
    text = f'<robot name="x">{root}{chain("b", 3, "base", first="0.2 0 0.5")}</robot>'
    wish = Wishes(arms=(Arm("short", "world", "b2"),), base_frame="base")
    assert proposed(text, tmp_path, wish).words.arms == (Arm("short", "base", "b2"),)


def test_the_tool_frame_lies_between_the_finger_tips(tmp_path):
    plain, _ = without_meshes(load_urdf(mesh_robot.write_package(tmp_path)))
    found = propose(plain, Wishes())
    (arm,) = found.words.arms
    assert (arm.name, arm.base_link, arm.tool_frame) == ("arm", "torso_link", "arm_tool_frame")
    pose = found.urdf.model.get_transform(arm.tool_frame, "hand_link")
    np.testing.assert_allclose(pose[:3, 3], [mesh_robot.TIP - 0.02, 0, 0], atol=1e-4)
    np.testing.assert_allclose(pose[:3, 0], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(np.abs(pose[:3, 1]), [0, 1, 0], atol=1e-6)
    assert found.words.gripper_joints == {"left_joint": 0.04, "right_joint": 0.04}
    assert found.words.torso_joint == "torso_joint"


WISHES = Wishes(
    name="mine", base_frame="base_link", footprint=(-1.0, 1.0, -0.5, 0.5), torso_joint="",
    arms=(Arm("one", "torso_link", "hand_link"),), body=("base_link",), held={"torso_joint": 0.1},
    home={"pan_joint": 0.5}, excludes=(("base_link", "hand_link"),),
)  # fmt: skip


def test_every_wish_comes_first(tmp_path):
    plain, _ = without_meshes(load_urdf(mesh_robot.write_package(tmp_path)))
    words = propose(plain, WISHES).words
    for name in ("name", "base_frame", "footprint", "arms", "body", "home", "excludes"):
        assert getattr(words, name) == getattr(WISHES, name)
    assert (words.torso_joint, words.torso_position) == (None, None)
    assert words.gripper_joints["torso_joint"] == 0.1
    wishes = Wishes(torso_position=0.07)
    assert propose(plain, wishes).words.torso_position == 0.07


@pytest.mark.parametrize(
    "wishes",
    [
        Wishes(base_frame="nowhere"),
        Wishes(torso_joint="nowhere"),
        Wishes(held={"nowhere": 0.0}),
        Wishes(arms=(Arm("one", "torso_link", "nowhere"),)),
        Wishes(arms=(Arm("one", "nowhere", "hand_link"),)),
    ],
)
def test_a_wish_for_what_is_not_there(wishes, tmp_path):
    plain, _ = without_meshes(load_urdf(mesh_robot.write_package(tmp_path)))
    with pytest.raises(RobotError, match=r"has no (link|joint) 'nowhere'"):
        propose(plain, wishes)


def test_a_footprint_of_a_point_has_some_size(tmp_path):
    text = (
        f'<robot name="x"><link name="a">{box("1e-9 1e-9 1e-9")}</link>{chain("b", 6, "a")}</robot>'
    )
    x0, x1, y0, y1 = proposed(text, tmp_path).words.footprint
    assert x1 - x0 >= 0.01
    assert y1 - y0 >= 0.01


def parts_of(tmp_path, *parts):
    """The structure of a robot of such parts, and the chain of its joints below each first link."""
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    structure = Structure(urdf, urdf.model.base_link)
    return structure, lambda first: [urdf.joint(f"{first}_joint")]


@pytest.mark.parametrize(
    ("link_name", "side"),
    [
        ("LeftArm", "left"), ("l_elbow", "left"), ("elbow_r", "right"), ("RElbow", "right"),
        ("left_of_right", ""), ("lift", ""), ("relay", ""), ("base", ""),
    ],
)  # fmt: skip
def test_a_side_is_a_word_of_a_name(link_name, side):
    assert _side(link_name) == side


def test_arms_are_named_by_where_they_are_or_numbered(tmp_path):
    arms = [chain(name, 1, "base", first=f"0 {y} 1") for name, y in (("p", 0.3), ("q", -0.3))]
    third = chain("s", 1, "base", first="0 0.1 1")
    structure, first = parts_of(tmp_path, link("base"), *arms, third)
    one, other, more = first("p0"), first("q0"), first("s0")
    assert _names(structure, [one]) == ["arm"]
    assert _names(structure, [one, other]) == ["left", "right"]
    assert _names(structure, [other, one]) == ["right", "left"]
    assert _names(structure, [one, more]) == ["arm-1", "arm-2"]
    assert _names(structure, [one, other, more]) == ["arm-1", "arm-2", "arm-3"]


@pytest.mark.parametrize(("at", "position"), [(1.0, -0.1), (3.0, -0.9), (-1.0, 0.9)])
def test_a_torso_holds_its_arms_a_metre_high_and_keeps_from_its_ends(tmp_path, at, position):
    lift = link("lift") + joint("lift", "base", f"0 0 {at}", "0 0 1", "prismatic")
    arm = chain("arm", 2, "lift", first="0 0 0.1") + chain("high", 2, "lift", first="0 0 0.5")
    structure, first = parts_of(tmp_path, link("base"), lift, arm)
    chains = [first("high0"), first("arm0")]
    found = _torso_position(structure, structure.urdf.joint("lift_joint"), chains)
    assert found == position


def test_a_footprint_is_around_what_is_low_in_full_millimetres(tmp_path):
    low, wide = box("0.2004 0.1 0.2", "0 0 0.1"), box("1 2 0.1", "0 0 0.6")
    structure, _ = parts_of(tmp_path, link("base", low + wide), chain("a", 1, "base", first=FRONT))
    notes = []
    assert _footprint(structure, {"a0"}, notes) == (-0.101, 0.101, -0.05, 0.05)
    assert _footprint(structure, set(), notes)[1] == 0.225  # as the arm begins low as well
    structure, _ = parts_of(tmp_path, link("base", wide))
    assert _footprint(structure, set(), notes) == (-0.5, 0.5, -1.0, 1.0)
    assert notes == []
    structure, _ = parts_of(tmp_path, link("base", ""))
    assert _footprint(structure, set(), notes) == (-0.1, 0.1, -0.1, 0.1)
    assert "nothing but arms collides" in notes[0]


def test_the_body_is_what_is_high_enough_for_an_arm(tmp_path):
    parts = (
        link("base", box("0.2 0.2 0.2", "0 0 0.1")), link("mast", box("0.1 0.1 1")),
        joint("mast", "base", "0 0 0.5"), link("arm"), joint("arm", "base", "0 0 0.5"),
        link("bare", ""), joint("bare", "base", "0 0 1"),
    )  # fmt: skip
    structure, _ = parts_of(tmp_path, *parts)
    assert _body(structure, {"arm"}) == ("mast",)


def test_a_slide_below_one_of_two_arms_is_no_torso(tmp_path):
    """As where each arm has a lift of its own."""
    text = link("base", box("0.3 0.3 0.3", "0 0 0.15"))
    for name, at in (("left", "0.2 0.3 0.5"), ("right", "0.2 -0.3 0.5")):
        text += link(f"{name}_lift") + joint(f"{name}_lift", "base", at, kind="prismatic")
        text += chain(name, 5, f"{name}_lift")
    words = proposed(f'<robot name="x">{text}</robot>', tmp_path).words
    assert {arm.base_link for arm in words.arms} == {"left_lift", "right_lift"}
    assert words.torso_joint is None
    assert words.gripper_joints == {"left_lift_joint": 0.0, "right_lift_joint": 0.0}


def test_an_arm_without_joints_of_its_own_is_named(tmp_path):
    text = "".join((link("base", box("0.3 0.3 1", "0 0 0.5")), chain("p", 4, "base", first=FRONT)))
    wish = Wishes(arms=(Arm("whole", "base", "p3"), Arm("part", "base", "base")))
    with pytest.raises(RobotError, match="no joints of its own between 'base' and 'base'"):
        proposed(f'<robot name="x">{text}</robot>', tmp_path, wish)


def test_a_tool_frame_has_a_name_of_its_own_and_one_arm_is_no_others(tmp_path):
    taken = link("arm_tool_frame", "") + joint(
        "arm_tool_frame", "base", "0 0 2", kind="fixed", more=""
    )
    base = link("base", box("0.3 0.3 1", "0 0 0.5"))
    text = "".join((base, taken, chain("arm", 6, "base", first="0.2 0 0.5")))
    found = proposed(f'<robot name="x">{text}</robot>', tmp_path)
    assert found.words.arms == (Arm("arm", "base", "arm_tool_frame_added"),)
    assert not any(note.startswith("no arms") for note in found.notes)


def test_a_torso_that_turns_without_end_stays():
    assert _torso_position(None, SimpleNamespace(type="continuous"), []) == 0.0


def test_a_tool_frame_lies_between_fingers_that_are_held_as_wished(tmp_path):
    """Though they were opened to see how far."""
    plain, _ = without_meshes(load_urdf(mesh_robot.write_package(tmp_path)))
    found = propose(plain, Wishes(held={"left_joint": 0.0}))
    assert found.words.gripper_joints == {"left_joint": 0.0, "right_joint": 0.04}
    pose = found.urdf.model.get_transform("arm_tool_frame", "hand_link")
    assert pose[1, 3] == pytest.approx(-0.02, abs=1e-6)


def test_slides_below_a_torso_are_held_and_told(tmp_path):
    slides = "".join(
        link(name) + joint(name, above, "0 0 0.5", axis, "prismatic")
        for name, above, axis in (
            ("along", "base", "1 0 0"),
            ("across", "along", "0 1 0"),
            ("up", "across", "0 0 1"),
        )
    )
    text = link("base", box("0.3 0.3 1", "0 0 0.5")) + slides + chain("arm", 6, "up")
    text = f'<robot name="x">{text}</robot>'
    found = proposed(text, tmp_path)
    assert found.words.torso_joint == "up_joint"
    (note,) = (note for note in found.notes if "whole arm" in note)
    assert note.startswith("what moves a whole arm is held, 'along_joint' at 0, 'across_joint' at")
    assert "by --hold, or name an arm that has these joints" in note
    given = proposed(text, tmp_path, Wishes(held={"along_joint": 0.5, "across_joint": 0.0}))
    assert not any("whole arm" in note for note in given.notes)
    every = proposed(text, tmp_path, Wishes(arms=(Arm("arm", "base", "arm5"),)))
    assert not any("whole arm" in note for note in every.notes)
