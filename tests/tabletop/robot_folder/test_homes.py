"""Homes of robots without one: arms clear of each other, and of a table before the robot."""

import pytest
import torch
from small_urdfs import LIMIT, box, chain, joint, link, urdf_of

from cgtorch.tabletop.kinematics import scene
from cgtorch.tabletop.kinematics.clear_ways import OWN, REACH
from cgtorch.tabletop.kinematics.scene import (
    _clear_of_nothing_else,
    home_postures,
    placed_at,
    scene_of,
    shoulders_touching,
)
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.proposal import Wishes

WIDE = LIMIT.replace('"-1"', '"-3"').replace('upper="1"', 'upper="3"')
BASE = link("base", box("0.2 0.2 0.6", "0 0 0.3"))


@pytest.fixture(autouse=True)
def few_postures(monkeypatch):
    monkeypatch.setattr(scene, "SAMPLES", 256)
    monkeypatch.setattr(scene, "TRIED", 256)


def made(tmp_path, *parts):
    return make_robot_folder(urdf_of(tmp_path, *parts), tmp_path / "made").robot


def test_two_arms_are_clear_of_each_other(tmp_path):
    two = (
        chain(name, 6, "base", "0.12 0 0", "0 0 0.7").replace(LIMIT, WIDE)
        for name in ("one", "two")
    )
    robot = made(tmp_path, BASE, *two)
    footprint, found = robot.description.footprint, []
    for home in (
        robot.home,
        [home_postures((a,), robot.body, footprint, {})[0] for a in robot.arms],
    ):
        touches = []
        for arm, at, other, there in zip(
            robot.arms, home, robot.arms[::-1], home[::-1], strict=True
        ):
            beside = scene_of(arm, robot.body, placed_at(other, there))
            own = (beside.pairs[:, :2] >= OWN).all(1)
            alone = scene.replace(beside, pairs=beside.pairs[own], reach=beside.reach[own])
            kind = torch.tensor([REACH])
            touches.append(not _clear_of_nothing_else(arm, alone, kind, at[None].double()))
        found.append(touches)
    assert found == [[False, False], [True, True]]  # as each would be alone, they would touch


def test_an_arm_is_clear_of_a_table_before_the_robot_if_it_can_be(tmp_path):
    """Its first link leads aside at the height of tables, wherever that is turned to."""
    first = link("pan", box("0.4 0.1 0.1", "0.2 0 0")) + joint("pan", "base", "0 0 0.7", more=WIDE)
    arm = chain("arm", 5, "pan", "0 0 0.12", "0 0 0.1").replace(LIMIT, WIDE)
    robot = made(tmp_path, BASE, first, arm)
    (model,), (home,), front = robot.arms, robot.home, robot.description.footprint[1]
    clear = scene._clear_of_table(model, robot.body, torch.stack([home, 0 * home]).double(), front)
    assert clear.tolist() == [True, False]


def drone(tmp_path, home=None):
    """An arm below a wide box on skids, against which its upper arm can be turned."""
    wide = LIMIT.replace('"-1"', '"-2.4"').replace('upper="1"', 'upper="2.4"')
    skids = "".join(box("0.02 0.02 0.3", f"{x} {y} -0.2") for x in (-0.2, 0.2) for y in (-0.2, 0.2))
    parts, above = [link("base", box("0.5 0.5 0.1") + skids)], "base"
    for i, (at, axis, long) in enumerate(
        (
            ("0.05 0 -0.05", "0 0 1", 0.04),
            ("0 0 -0.04", "0 1 0", 0.22),
            ("0 0 -0.22", "0 1 0", 0.2),
            ("0 0 -0.2", "0 1 0", 0.06),
            ("0 0 -0.06", "0 0 1", 0.03),
        )
    ):
        shape = box(f"0.03 0.03 {long}", f"0 0 {-long / 2}")
        parts += [link(f"m{i}", shape), joint(f"m{i}", above, at, axis, more=wide)]
        above = f"m{i}"
    wishes = Wishes(home=home or {})
    return make_robot_folder(urdf_of(tmp_path, *parts), tmp_path / "made", wishes)


def test_first_links_are_clear_of_the_body_if_they_can_be(tmp_path, monkeypatch):
    monkeypatch.setattr(scene, "TRIED", 4)  # of which none is
    found = drone(tmp_path)
    (arm,), (home,) = found.robot.arms, found.robot.home
    assert shoulders_touching(arm, found.robot.body, home) == []
    assert not any("touches" in note for note in found.notes)


def test_first_links_that_touch_the_body_at_a_given_home_are_told(tmp_path):
    found = drone(tmp_path, {"m1_joint": 2.4})
    assert "at home of arm 'arm' 'm1' touches 'base': give another home by --home" in found.notes
