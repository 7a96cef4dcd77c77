"""Another home where nothing can be grasped from the computed one."""

import dataclasses

import pytest
import torch
from small_urdfs import box, fingers, joint, link, urdf_of

from cgtorch.tabletop.robot_folder import homes, make
from cgtorch.tabletop.robot_folder.homes import RAISED, better_home
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.proposal import Wishes
from cgtorch.tabletop.robot_folder.reach import Reached

ENDS = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
JOINTS = ("lift", "out", "yaw", "pitch", "roll")
COMPUTED = dict.fromkeys((f"{name}_joint" for name in JOINTS), 0.1)
NONE = Reached(torch.zeros(9, dtype=torch.bool), "why", somewhere=False)


def telescope(place, lift=(0, 1, "0 0 1")):
    """A robot that lifts an arm, and moves it out."""
    low, high, up = lift
    return urdf_of(
        place,
        link("base", box("0.3 0.3 0.2", "0 0 0.1")),
        link("lift") + joint("lift", "base", "0 0 0.3", up, "prismatic", ENDS.format(low, high)),
        link("out") + joint("out", "lift", "0.1 0 0", "1 0 0", "prismatic", ENDS.format(0.02, 0.6)),
        link("yaw") + joint("yaw", "out", "0.1 0 0", "0 0 1", more=ENDS.format(-1, 3)),
        link("pitch") + joint("pitch", "yaw", "0.1 0 0", "0 1 0"),
        link("roll") + joint("roll", "pitch", "0.1 0 0", "1 0 0", "continuous", more=""),
        fingers("jaw", "roll", "0.05 {} 0"),
    )


@pytest.fixture(autouse=True)
def nothing_is_tried(monkeypatch):
    monkeypatch.setattr(make, "reached", lambda robot, stand: Reached(NONE.grasps))


@pytest.fixture
def robot(tmp_path):
    made = make_robot_folder(telescope(tmp_path), tmp_path / "made", Wishes(home=COMPUTED))
    return made.robot


def test_other_homes_are_the_middle_and_nought_with_slides_raised(robot, tmp_path):
    (middle, zero, raised), (arm,) = homes._postures(robot, robot.arms[0]), robot.arms
    assert list(arm.joint_names) == [f"{name}_joint" for name in JOINTS]
    assert middle.tolist() == pytest.approx([0.5, 0.31, 1, 0, 0])
    assert zero.tolist() == pytest.approx([0, 0.02, 0, 0, 0])
    assert raised.tolist() == pytest.approx([RAISED, 0.02, 0, 0, 0])
    path = telescope(tmp_path, (-1, 0, "0 0 -1"))
    other = make_robot_folder(path, tmp_path / "other", Wishes(home={"lift_joint": -0.1})).robot
    assert homes._postures(other, other.arms[0])[2][0] == pytest.approx(-RAISED)


def test_the_home_with_most_clear_ways_is_taken(robot, monkeypatch):
    lifts = {0.5: 2, 0.0: 0, RAISED: 3}

    def counted(other, position, table):
        return torch.arange(len(position)) < lifts[round(float(other.home[0][0]), 3)]

    monkeypatch.setattr(homes, "graspable", counted)
    monkeypatch.setattr(homes, "progress", lambda *about: (3, 2, 1))
    assert float(better_home(robot).home[0][0]) == pytest.approx(RAISED)
    monkeypatch.setattr(homes, "clear_of_robot", lambda arm, scene, q: q[:, 0] < 0.6)
    assert float(better_home(robot).home[0][0]) == pytest.approx(0.5)
    lifts[0.5] = 0
    assert better_home(robot) is None


def test_where_nothing_can_be_approached_no_home_is_tried(robot, monkeypatch):
    monkeypatch.setattr(homes, "progress", lambda *about: (3, 2, 0))
    monkeypatch.setattr(homes, "graspable", lambda *about: pytest.fail("tried"))
    assert better_home(robot) is None


def test_another_home_is_written_only_if_nothing_can_be_grasped(tmp_path, monkeypatch):
    def better(robot):
        return dataclasses.replace(robot, home=(torch.full((5,), 0.123456).double(),))

    def lift_at(name, home=None):
        wishes = Wishes(home=home or {})
        robot = make_robot_folder(telescope(tmp_path), tmp_path / name, wishes).robot
        return robot.description.home["lift_joint"]

    monkeypatch.setattr(make, "better_home", better)
    monkeypatch.setattr(make, "reached", lambda robot, stand: NONE)
    assert lift_at("none") == 0.1235
    assert lift_at("given", COMPUTED) == 0.1
    monkeypatch.setattr(make, "reached", lambda robot, stand: Reached(NONE.grasps, "why"))
    assert lift_at("lower") != 0.1235


def test_a_home_in_few_digits_is_within_its_limits(tmp_path):
    path = telescope(tmp_path)
    path.write_text(path.read_text().replace('upper="3"', 'upper="0.12346"'))
    robot = make_robot_folder(path, tmp_path / "made", Wishes(home={"yaw_joint": 0.12346})).robot
    assert make._home_of(robot)["yaw_joint"] == 0.12346
