"""The parts of a robot: which links move together, what is seen of them, and how hands open."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_urdfs import LIMIT, box, chain, fingers, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.hands import (
    BEYOND_END,
    FROM_TIP,
    JAW_OPEN,
    MOST_TRIED,
    STEPS,
    _across,
    _approach,
    _opening,
    open_fingers,
    tool_of,
)
from cgtorch.tabletop.robot_folder.structure import Structure, _outline

BASE = link("base", box("0.3 0.3 1", "0 0 0.5"))
PLATE = link("plate", "") + joint("plate", "base", "0 0 2", kind="fixed", more="")


def structure_of(tmp_path: Path, *parts: str) -> Structure:
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    return Structure(urdf, urdf.model.base_link)


def test_links_that_are_fixed_to_one_another_move_together(tmp_path: Path) -> None:
    follows = LIMIT + '<mimic joint="a0_joint"/>'
    structure = structure_of(
        tmp_path, BASE, PLATE, chain("a", 2, "plate"), link("b"), joint("b", "base", more=follows)
    )
    assert structure.rigid("base") == ["base", "plate"]
    assert {each.name for each in structure.moved("base")} == {"a0_joint", "b_joint"}
    assert set(structure.hanging("base")) == {"base", "plate", "a0", "a1", "b"}
    assert structure.hanging("a0") == ["a0", "a1"]
    assert [each.name for each in structure.path("a1")] == ["a0_joint", "a1_joint"]
    assert structure.path("b") == []  # as it is not independent
    assert structure.above["plate"].name == "plate_joint"
    assert "base" not in structure.above


def test_what_is_seen_is_taken_where_nothing_collides(tmp_path: Path) -> None:
    bare = link("bare", box("2 2 2", "0 0 1", "visual")) + joint("bare", "base", "0 0 3")
    structure = structure_of(tmp_path, BASE, PLATE, bare)
    assert structure.points("bare").shape == (0, 3)
    found = structure.seen(["base", "bare"])
    assert found[:, 2].tolist().count(5) == 4  # the upper corners of what is seen
    assert found.min(0).tolist() == [-1, -1, 0]
    assert structure.seen(["bare"], "bare")[:, 2].max() == 2
    assert structure.points("base")[:, 2].max() == 1
    corners = {"base": [np.array([[1.0, 2.0, 3.0]])]}
    given = Structure(structure.urdf, "plate", corners)
    assert given.points("base").tolist() == [[1, 2, 1]]  # 2 m below the plate


def test_outlines_of_boxes_cylinders_and_spheres() -> None:
    def outline(**shape: Any) -> Any:
        return _outline(SimpleNamespace(**{"box": None, "cylinder": None, "sphere": None, **shape}))

    corners = outline(box=SimpleNamespace(size=(2, 4, 6)))
    assert len({tuple(corner) for corner in corners.tolist()}) == 8
    assert np.abs(corners).tolist() == [[1, 2, 3]] * 8
    drum = outline(cylinder=SimpleNamespace(radius=0.5, length=4.0))
    assert np.hypot(drum[:, 0], drum[:, 1]) == pytest.approx([0.5] * 32)
    assert sorted(drum[:, 2].tolist()) == [-2.0] * 16 + [2.0] * 16
    ball = outline(sphere=SimpleNamespace(radius=3.0))
    assert np.linalg.norm(ball, axis=1) == pytest.approx([3.0] * 48)
    for axis in np.eye(3):
        for sign in (-3, 3):
            assert np.linalg.norm(ball - sign * axis, axis=1).min() < 1e-9


@pytest.mark.parametrize(
    ("x", "wanted", "found"),
    [
        ([1, 0, 0], [5, 0.1, 1], [0, 0, 1]),  # an axis that is nearly there
        ([1, 0, 0], [0, 0.1, -1], [0, 0, -1]),
        ([1, 0, 0], [0, 3, 3], [0, 0.5**0.5, 0.5**0.5]),
        ([0.6, 0.8, 0], [1, 0, 0], [0.8, -0.6, 0]),  # no axis is across
        ([0.6, 0.8, 0], [0, 0, 2], [0, 0, 1]),
        ([0.28, 0.96, 0], [1, 0, 0], [0.96, -0.28, 0]),  # an axis is nearly there, but not across
    ],
)
def test_the_way_across_is_nearest_to_what_is_wanted(
    x: list[float], wanted: list[float], found: list[float]
) -> None:
    assert _across(np.array(x, float), np.array(wanted, float)) == pytest.approx(found)


def test_where_nothing_across_is_wanted_anything_across_is() -> None:
    for x in (np.eye(3)[0], np.array([0.6, 0.0, 0.8])):
        y = _across(x, 2 * x)
        assert y @ x == pytest.approx(0)
        assert np.linalg.norm(y) == pytest.approx(1)


def sliding(name: str, y: float, more: str = LIMIT) -> str:
    """A finger that slides along y, and begins there."""
    return link(name) + joint(name, "arm5", f"0 {y} 0.05", "0 1 0", "prismatic", more)


def test_fingers_open_to_where_they_are_farthest_apart(tmp_path: Path) -> None:
    arm = chain("arm", 6, "base", first="0 0 1")
    two = sliding("a", 0.03), sliding("b", -0.03)
    follower = sliding("c", 0.0, LIMIT + '<mimic joint="a_joint"/>')
    structure = structure_of(tmp_path, BASE, arm, *two, follower)
    assert open_fingers(structure, "arm5") == {"a_joint": 1.0, "b_joint": -1.0}
    assert _opening(structure, "arm5") == pytest.approx(2.06 + 0.05)  # of their outer faces
    assert open_fingers(structure_of(tmp_path, BASE, arm), "arm5") == {}


def test_small_fingers_open_and_what_moves_nothing_that_is_seen_stays_at_its_lower_limit(
    tmp_path: Path,
) -> None:
    arm = chain("arm", 6, "base", first="0 0 1")
    short = LIMIT.replace('"-1"', '"-0.02"').replace('"1"', '"0.01"', 1)
    two = sliding("a", 0.03, short), sliding("b", -0.03, short)
    bare = link("c", "") + joint("c", "arm5")
    structure = structure_of(tmp_path, BASE, arm, *two, bare)
    assert open_fingers(structure, "arm5") == {"a_joint": 0.01, "b_joint": -0.02, "c_joint": -1.0}


def test_of_many_fingers_all_are_at_their_lower_or_upper_limits(tmp_path: Path) -> None:
    limits = LIMIT.replace('"-1"', '"0"').replace('upper="1"', 'upper="0.5"')
    many = [sliding(f"f{i}", 0.1 * i, limits if i else LIMIT) for i in range(MOST_TRIED + 1)]
    structure = structure_of(tmp_path, BASE, chain("arm", 6, "base", first="0 0 1"), *many)
    found = open_fingers(structure, "arm5")
    assert found == {"f0_joint": -1.0} | {f"f{i}_joint": 0.0 for i in range(1, MOST_TRIED + 1)}


def test_a_jaw_opens_for_an_object_of_usual_size(tmp_path: Path) -> None:
    palm = link("arm5", box("0.02 0.02 0.1", "0 -0.02 0.05")) + joint("arm5", "arm4")
    limits = LIMIT.replace('"-1"', '"0"').replace('upper="1"', 'upper="0.3"')
    jaw = link("jaw", box("0.02 0.02 0.1", "0 0 0.05"))
    jaw += joint("jaw", "arm5", "0 0.02 0.0", "0 1 0", "prismatic", limits)
    structure = structure_of(tmp_path, BASE, chain("arm", 5, "base", first="0 0 1"), palm, jaw)
    (position,) = open_fingers(structure, "arm5").values()
    assert _opening(structure, "arm5") == pytest.approx(JAW_OPEN, abs=0.3 / (STEPS - 1))
    assert 0.03 < position < 0.1


def test_a_hand_of_one_finger_without_a_body_has_no_opening(tmp_path: Path) -> None:
    arm = chain("arm", 5, "base", first="0 0 1") + link("arm5", "") + joint("arm5", "arm4")
    structure = structure_of(tmp_path, BASE, arm, sliding("a", 0.0))
    assert _opening(structure, "arm5") == 0.0


def frame(
    name: str, at: tuple[float, ...], rpy: tuple[float, ...] = (0.0, -math.pi / 2, 0.0)
) -> str:
    """A link that is fixed to the hand `arm5`, by default with x along its z."""
    words = " ".join(map(str, at)), " ".join(map(str, rpy))
    made = joint(name, "arm5", "0 0 0", kind="fixed", more="")
    return link(name, "") + made.replace('xyz="0 0 0"', f'xyz="{words[0]}" rpy="{words[1]}"')


TIP = 0.05 + 0.025  # m along z from the hand to the tips of its fingers


@pytest.mark.parametrize(
    ("at", "rpy", "taken"),
    [
        ((0, 0, TIP - 0.02), (0, -math.pi / 2, 0), True),
        ((0, 0, TIP - 0.059), (0, -math.pi / 2, 0), True),
        ((0, 0, TIP - 0.061), (0, -math.pi / 2, 0), False),
        ((0, 0, TIP + 0.004), (0, -math.pi / 2, 0), True),
        ((0, 0, TIP + 0.006), (0, -math.pi / 2, 0), False),
        ((0.014, 0, TIP), (0, -math.pi / 2, 0), True),
        ((0.008, 0.014, TIP), (0, -math.pi / 2, 0), False),
        ((0, 0, TIP), (0, -math.pi / 2 + 0.3, 0), True),
        ((0, 0, TIP), (0, -math.pi / 2 + 0.35, 0), False),
        ((0, 0, TIP), (0.44, -math.pi / 2, 0), True),
        ((0, 0, TIP), (0.46, -math.pi / 2, 0), False),
        ((0, 0, TIP), (math.pi, -math.pi / 2, 0), True),
        ((0, 0, TIP), (0, math.pi / 2, 0), False),  # it leads back
    ],
)
def test_a_frame_near_the_finger_tips_is_the_tool_frame(
    tmp_path: Path, at: tuple[float, ...], rpy: tuple[float, ...], taken: bool
) -> None:
    arm = chain("arm", 6, "base", first="0 0 1")
    structure = structure_of(tmp_path, BASE, arm, fingers("f", "arm5"), frame("there", at, rpy))
    tool = tool_of(structure, "arm5")
    assert (tool.link, tool.parent, tool.fingers) == ("there" if taken else None, "arm5", True)
    assert tool.pose[:3, 3] == pytest.approx(at if taken else (0, 0, TIP - FROM_TIP))
    if not taken:
        assert tool.pose[:3, 0] == pytest.approx([0, 0, 1])
        assert np.abs(tool.pose[:3, 1]) == pytest.approx([0, 1, 0])


def test_of_three_fingers_the_two_that_are_farthest_apart_have_the_tool_between_them(
    tmp_path: Path,
) -> None:
    places = {"a": (0.02, 0.0), "b": (0.0, 0.03), "c": (0.0, -0.03)}
    hand = "".join(
        link(name) + joint(name, "arm5", f"{x} {y} 0.05", "1 0 0")
        for name, (x, y) in places.items()
    )
    arm = chain("arm", 6, "base", first="0 0 1")
    tool = tool_of(structure_of(tmp_path, BASE, arm, hand), "arm5")
    assert (tool.link, tool.fingers) == (None, True)
    assert tool.pose[:2, 3] == pytest.approx([0, 0])
    assert np.abs(tool.pose[:3, 1]) == pytest.approx([0, 1, 0])


@pytest.mark.parametrize(("ahead", "taken"), [(-0.029, True), (-0.031, False), (0.13, True)])
def test_without_fingers_a_frame_may_be_where_a_gripper_would_hold(
    tmp_path: Path, ahead: float, taken: bool
) -> None:
    """Turned about its approach as it likes."""
    end = 0.025 + BEYOND_END
    there = frame("there", (0, 0, end + ahead), (0.7, -math.pi / 2, 0))
    arm = chain("arm", 5, "base", first="0 0 1") + link("arm5") + joint("arm5", "arm4")
    tool = tool_of(structure_of(tmp_path, BASE, arm, there), "arm5")
    assert (tool.link, tool.fingers) == ("there" if taken else None, False)
    assert tool.pose[:3, 3] == pytest.approx([0, 0, end + (ahead if taken else 0)])


def test_of_several_frames_one_with_a_usual_name_is_taken_and_then_the_nearest(
    tmp_path: Path,
) -> None:
    arm = chain("arm", 6, "base", first="0 0 1") + fingers("f", "arm5")
    near, far = (0.0, 0.0, TIP - 0.021), (0.0, 0.0, TIP - 0.03)

    def taken(*frames: str) -> str | None:
        return tool_of(structure_of(tmp_path, BASE, arm, *frames), "arm5").link

    assert taken(frame("a", far), frame("b", near)) == "b"
    for name in ("my_tool", "grasp_frame", "tcp", "gripper_link"):
        assert taken(frame("a", near), frame(name, far)) == name
    assert taken(frame("tcp", far), frame("tool", near)) == "tool"


def test_a_hand_that_nothing_is_known_of_holds_before_its_frame(tmp_path: Path) -> None:
    arm = chain("arm", 5, "base", first="0 0 1") + link("arm5", "") + joint("arm5", "arm4")
    tool = tool_of(structure_of(tmp_path, BASE, arm), "arm5")
    assert tool.pose[:3, 3] == pytest.approx([0, 0, BEYOND_END])
    assert tool.pose[:3, :3] @ tool.pose[:3, :3].T == pytest.approx(np.eye(3))


@pytest.mark.parametrize(
    ("toward", "found"),
    [
        ([0, 0.82, 0.57], [0, 1, 0]),  # nearly along the axis of the last joint
        ([0, -0.82, 0.57], [0, -1, 0]),
        ([0, 0.78, 0.63], [0, 1, 0]),  # else along the best axis of the hand
        ([0, 0.6, 0.8], [0, 0, 1]),
        ([0.1, 0.6, -0.8], [0, 0, -1]),
        ([-0.9, 0.3, 0.3], [-1, 0, 0]),
    ],
)
def test_a_hand_leads_along_its_joint_or_an_axis_of_its_frame(
    tmp_path: Path, toward: list[float], found: list[float]
) -> None:
    structure = structure_of(tmp_path, BASE, chain("arm", 6, "base", first="0 0 1"))
    assert _approach(structure, "arm5", np.array(toward)) == pytest.approx(found)
