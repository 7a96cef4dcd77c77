"""Where nothing is grasped: advice of a stand or a footprint, and frames that are turned over."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from small_urdfs import LIMIT, box, chain, fingers, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder import make, reach, stands
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.proposal import Wishes
from cgtorch.tabletop.robot_folder.reach import AHEAD, DEPTHS, Reached
from cgtorch.tabletop.robot_folder.stands import better_stand
from cgtorch.tabletop.robot_folder.structure import Structure
from cgtorch.tabletop.robot_folder.turns import OVER, turned_over, turns_fully

NONE = torch.zeros(9, dtype=torch.bool)


def test_the_stand_with_most_objects_is_advised(monkeypatch):
    counts = {0.5: 2, 0.8: 3, 1.1: None}
    monkeypatch.setattr(stands, "graspable", lambda robot, *about: torch.arange(9) < robot.count)
    monkeypatch.setattr(stands, "objects", lambda *about: ())

    def on_stand(height):
        return None if counts[height] is None else SimpleNamespace(count=counts[height])

    assert better_stand(on_stand, 0.2) == (
        "on a stand of 0.8 m, on which less of it is near the floor, it can grasp 3 of 9, so put "
        "it there by --stand 0.8"
    )
    counts.update({0.5: 0, 0.8: None})
    assert better_stand(on_stand, 0.2) == ""


@pytest.mark.parametrize(("reaches", "shoulder"), [(0.1, 0), (0.3, 0), (0.1, 1)])
def test_a_footprint_that_holds_all_that_is_reached_is_told(monkeypatch, reaches, shoulder):
    pose = torch.eye(4).expand(3, 5, 4, 4).clone()
    pose[1, :, 0, 3], pose[2, :, 0, 3] = shoulder, 1.0 + reaches
    robot = SimpleNamespace(
        arms=[SimpleNamespace(frames=lambda q: pose)],
        description=SimpleNamespace(footprint=(-1, 1.0, -1, 1)),
    )
    monkeypatch.setattr(reach, "random_postures", lambda *about: None)
    said = reach._beside_footprint(robot, 0)
    inside = reaches < AHEAD + DEPTHS[0] and not shoulder  # of one that is too short anyway
    assert ("tool is more than 1.10 m ahead" in said and "ends at 1.00 m" in said) == inside
    assert bool(said) == inside


def robot(tmp_path, ends="-1 1"):
    low, high = ends.split()
    arm = chain("arm", 5, "base", first="0 0 0.7", at="0.1 0 0")
    last = LIMIT.replace('"-1"', f'"{low}"').replace('"1"', f'"{high}"', 1)
    parts = link("base", box("0.2 0.2 0.6", "0 0 0.3")), arm
    hand = link("hand") + joint("hand", "arm4", "0.1 0 0", "1 0 0", more=last)
    return urdf_of(tmp_path, *parts, hand, fingers("f", "hand", "0.06 {} 0"))


@pytest.mark.parametrize(("ends", "fully"), [("-3 3", False), ("-3.1 3.1", True)])
def test_a_joint_of_nearly_a_turn_holds_a_frame_both_ways_round(tmp_path, ends, fully):
    assert turns_fully(Structure(load_urdf(robot(tmp_path, ends)), "base"), "hand") == fully


def test_links_are_turned_over_with_their_joints(tmp_path):
    urdf = load_urdf(robot(tmp_path))
    over = turned_over(urdf, ["arm1"])
    poses = [each.model.get_transform("arm1", "arm0") for each in (urdf, over)]
    np.testing.assert_allclose(poses[0] @ OVER, poses[1], atol=1e-9)


@pytest.mark.parametrize("helps", [True, False])
def test_an_added_frame_is_turned_over_only_where_that_helps(tmp_path, monkeypatch, helps):
    made, seen = [], []

    def tried(robot, stand):
        tool = robot.urdf.model.get_transform("arm_tool_frame", "hand")
        seen.append(tool[:3, 2])
        return Reached(NONE, "why", somewhere=helps and len(seen) > 1, about="about")

    monkeypatch.setattr(make, "reached", tried)
    monkeypatch.setattr(make, "better_home", lambda robot: None)
    monkeypatch.setattr(make, "better_stand", lambda on_stand, stand: made.append(on_stand(0.9)))
    found = make_robot_folder(robot(tmp_path), tmp_path / "made", Wishes())
    assert seen[1] @ seen[0] == pytest.approx(-1)
    held = found.robot.urdf.model.get_transform("arm_tool_frame", "hand")[:3, 2]
    np.testing.assert_allclose(held, seen[int(helps)], atol=1e-9)
    assert any("turned by half a turn about x" in note for note in found.notes) == helps
    assert len(made) == (not helps)
