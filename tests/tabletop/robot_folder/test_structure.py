"""The parts of a robot: which links move together, what is seen of them, and how hands open."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_urdfs import LIMIT, box, chain, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.structure import (
    JAW_OPEN,
    MOST_TRIED,
    STEPS,
    Structure,
    _across,
    _opening,
    _outline,
    open_fingers,
)

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
