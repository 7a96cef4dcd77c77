"""Where the floor is, where a robot faces, and a stand."""

from types import SimpleNamespace

import numpy as np
import pytest
from lxml import etree
from small_urdfs import LIMIT, box, chain, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.base import _height, _unused, add_frame, rest_positions
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.structure import Structure

BASE = link("base", box("0.2 0.1 0.4", "0 0 0.2"))


def proposed(tmp_path, *parts, **wishes):
    return propose(load_urdf(urdf_of(tmp_path, *parts)), Wishes(**wishes))


@pytest.mark.parametrize(
    ("way", "degrees"), [("0 -0.1 0", -90), ("-0.1 0 0", 180), ("0.1 0 0", 0), ("0.09 0.05 0", 0)]
)
def test_x_leads_to_where_an_arm_reaches(tmp_path, way, degrees):
    found = proposed(tmp_path, BASE, chain("arm", 6, "base", way, "0 0 0.4"))
    turn = found.urdf.model.get_transform("base", found.words.base_frame)[:3, :3]
    reached = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])
    np.testing.assert_allclose(turn @ reached, [1, 0, 0], atol=1e-6)
    assert found.words.base_frame == ("base_footprint" if degrees else "base")
    assert any("degrees away from the x of 'base'" in note for note in found.notes) == bool(degrees)
    sides = (-0.05, 0.05, -0.1, 0.1) if degrees == -90 else (-0.1, 0.1, -0.05, 0.05)
    assert found.words.footprint == pytest.approx(sides)


@pytest.mark.parametrize("ways", [["prismatic"], ["revolute"], ["revolute"] * 2])
def test_a_slide_alone_or_turns_alone_drive_no_base(tmp_path, ways):
    parts, above = [link("odom", "")], "odom"
    for i, kind in enumerate(ways):
        name = f"way{i}" if i + 1 < len(ways) else "base"
        parts.append(BASE if name == "base" else link(name, ""))
        parts.append(joint(name, above, axis="1 0 0", kind=kind))
        above = name
    found = proposed(tmp_path, *parts, chain("arm", 6, "base"))
    assert not any("how the base drives" in note for note in found.notes)


def test_a_joint_that_moves_a_whole_robot_in_a_world_is_one_of_its_arm(tmp_path):
    """The shoulder of an arm whose root is called world; a joint that fixes it there is none."""
    found = proposed(tmp_path, link("world", ""), chain("arm", 6, "world"))
    arm = found.words.arms[0]
    joints = found.urdf.joints_between(arm.base_link, arm.tool_frame)
    assert [each.name for each in joints if each.type == "revolute"] == [
        f"arm{i}_joint" for i in range(6)
    ]


def test_an_arm_that_reaches_all_round_says_nothing_of_where_x_leads(tmp_path):
    arm = chain("arm", 6, "base", "0 -0.1 0", "0 0 0.4")
    round_ = arm.replace('"arm0_joint" type="revolute"', '"arm0_joint" type="continuous"')
    assert round_ != arm
    found = proposed(tmp_path, BASE, round_)
    assert found.words.base_frame == "base"
    assert not any("degrees away" in note for note in found.notes)


def test_an_arm_that_hangs_low_does_not_lower_the_floor(tmp_path):
    found = proposed(tmp_path, BASE, chain("arm", 6, "base", "0.02 0 -0.1", "0.15 0 0.4"))
    assert found.words.base_frame == "base"


def test_the_floor_is_not_above_where_an_arm_begins_if_only_its_hand_collides(tmp_path):
    arm = chain("arm", 5, "base", first="0 0 0.1", shapes="")
    hand = link("hand", box()) + joint("hand", "arm4")
    assert proposed(tmp_path, link("base", ""), arm, hand).words.base_frame == "base"
    down = chain("arm", 5, "base", "0 0 -0.1", "0 0 0.1", "")
    found = proposed(tmp_path, link("base", ""), down, hand.replace("0 0 0.1", "0 0 -0.1"))
    assert found.urdf.model.get_transform("base", "base_footprint")[2, 3] == pytest.approx(0.425)


def test_the_floor_is_below_an_arm_that_hangs_from_a_panel(tmp_path):
    """Whose shapes are above where the arm begins."""
    panel = link("base", box("0.4 0.4 0.1", "0 0 0.25"))
    arm = chain("arm", 6, "base", "0 0 -0.1", "0 0 0")
    found = proposed(tmp_path, panel, arm)
    assert found.urdf.model.get_transform("base", "base_footprint")[2, 3] == pytest.approx(0.525)
    level = link("base", box("0.4 0.4 0.1", "0 0 0.069"))
    found = proposed(tmp_path, level, arm)
    assert found.words.base_frame == "base"


def test_a_stand_lifts_the_robot_and_is_part_of_its_body(tmp_path):
    arm = chain("arm", 6, "base", "0.1 0 0", "0 0 0.4")
    found = proposed(tmp_path, BASE, arm, stand=0.5)
    words, model = found.words, found.urdf.model
    assert model.get_transform("base", words.base_frame)[2, 3] == pytest.approx(0.5)
    assert model.get_transform("stand", words.base_frame)[2, 3] == pytest.approx(0.25)
    np.testing.assert_allclose(
        model.link_map["stand"].collisions[0].geometry.box.size, [0.2, 0.1, 0.5]
    )
    assert words.footprint == (-0.1, 0.1, -0.05, 0.05)
    assert {"stand", "base"} <= set(words.body)
    with pytest.raises(RobotError, match="a stand needs a base frame of its own, not 'base'"):
        proposed(tmp_path, BASE, arm, stand=0.5, base_frame="base")


def test_a_stand_of_a_base_without_a_body_is_ten_centimetres_wide(tmp_path):
    arm = chain("arm", 6, "base", "0.1 0 0", "0 0 0.4")
    found = proposed(tmp_path, link("base", ""), arm, stand=0.5)
    model, words = found.urdf.model, found.words
    box = model.link_map["stand"].collisions[0].geometry.box
    np.testing.assert_allclose(box.size, [0.1, 0.1, 0.5])
    at = model.get_transform("stand", words.base_frame)[:3, 3]
    np.testing.assert_allclose(at, [0, 0, 0.25], atol=1e-9)


def test_the_floor_is_at_the_lowest_point_of_all_but_the_arms(tmp_path):
    """Or of these if nothing else collides, or at a footprint if there is one."""

    def height(*parts, of=()):
        urdf = load_urdf(urdf_of(tmp_path, *parts))
        structure, notes = Structure(urdf, "base"), []
        return _height(structure, [[urdf.joint(f"{name}_joint")] for name in of], notes), notes

    high, low = link("base", box("0.2 0.2 0.2", "0 0 0.4")), chain("arm", 1, "base", "0 0 -0.5")
    assert height(high, low) == (pytest.approx(0.525), [])
    assert height(high, low, of=["arm0"]) == (pytest.approx(0.525), [])  # it hangs
    under = link("base", box("0.2 0.2 0.2", "0 0 -0.1"))
    assert height(under, low, of=["arm0"]) == (pytest.approx(0.2), [])
    assert height(link("base", ""), low, of=["arm0"]) == (pytest.approx(0.525), [])
    assert height(link("base", box("0.2 0.2 0.2", "0 0 0.119"))) == (0.0, [])
    assert height(link("base", box("0.2 0.2 0.2", "0 0 0.121"))) == (pytest.approx(-0.021), [])
    wheel = link("wheel", box("0.1 0.1 0.1", kind="visual")) + joint("wheel", "base", "0 0 -0.5")
    assert height(high, wheel) == (pytest.approx(0.55), [])  # which is only seen
    foot = link("my_footprint", "") + joint(
        "my_footprint", "base", "0 0 -0.3", kind="fixed", more=""
    )
    assert height(high, low, foot) == (pytest.approx(0.3), [])
    found, (note,) = height(link("base", ""))
    assert found == 0.0
    assert note == "nothing collides, so that 'base' is taken to be on the floor"


def test_a_frame_is_added_below_a_link_or_above_it_under_a_free_name():
    known = SimpleNamespace(below={"stand": [], "stand_added": []})
    assert _unused(known, "floor") == "floor"
    assert _unused(known, "stand") == "stand_added_added"
    root, pose = etree.Element("robot"), np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3]
    add_frame(root, "tool", "hand", pose)
    add_frame(root, "floor", "base", pose, above=True)
    assert [each.get("name") for each in root.findall("link")] == ["tool", "floor"]
    below, above = root.findall("joint")
    assert (below.get("name"), below.get("type")) == ("tool_joint", "fixed")
    ends = [[each.find(end).get("link") for end in ("parent", "child")] for each in (below, above)]
    assert ends == [["hand", "tool"], ["floor", "base"]]
    assert below.find("origin").get("xyz") == "1.0 2.0 3.0"
    turned = [float(angle) for angle in below.find("origin").get("rpy").split()]
    assert turned == pytest.approx([0, 0, np.pi / 2])


def test_joints_rest_where_they_are_nearest_to_nought(tmp_path):
    far = LIMIT.replace('"-1"', '"0.5"')
    follows = LIMIT + '<mimic joint="a_joint"/>'
    parts = (
        BASE, link("a"), joint("a", "base", more=far), link("b"), joint("b", "base", more=follows),
        link("c"), joint("c", "base"), link("d"), joint("d", "base", kind="fixed", more=""),
    )  # fmt: skip
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    assert rest_positions(urdf) == {"a_joint": 0.5, "c_joint": 0.0}
    assert rest_positions(urdf, ("a_joint",)) == {"c_joint": 0.0}
