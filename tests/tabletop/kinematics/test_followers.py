"""Joints that follow others, or none that moves."""

import logging

import numpy as np
import pytest
from small_urdfs import LIMIT, box, joint, link, urdf_of

from cgtorch.tabletop.kinematics.followers import led
from cgtorch.tabletop.kinematics.urdf import checked_urdf, load_urdf, read_urdf


def follows(leader, multiplier=2, offset=0.1):
    return f'{LIMIT}<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def rows(*leaders, kind="revolute", more=LIMIT):
    """Link a, moved by a_joint, and links b, c, ... that follow leaders, all on the base."""
    parts = [link("base", box()), link("a"), joint("a", "base", kind=kind, more=more)]
    for name, leader in zip("bcd", leaders, strict=False):
        parts += [link(name), joint(name, "base", more=follows(leader), axis="0 0 2")]
    return parts


def turn_of(urdf, name):
    pose = urdf.model.get_transform(name, "base")
    return np.arctan2(pose[1, 0], pose[0, 0])


@pytest.mark.parametrize("leader", ["nobody", "b_joint", "a_joint"])
def test_what_follows_nothing_that_moves_is_held_still_and_told_once(tmp_path, caplog, leader):
    """A joint that is not there, itself, or a fixed joint."""
    path, notes = urdf_of(tmp_path, *rows(leader, kind="fixed", more="")), list[str]()
    urdf = checked_urdf(path, read_urdf(path, notes))
    assert notes == [
        "b_joint: held still, as what they follow does not move, is not there, or follows them in "
        "a circle; correct <mimic> if they should move"
    ]
    assert urdf.joint("b_joint").type == "fixed"
    assert turn_of(urdf, "b") == pytest.approx(0.1)
    assert not [each for each in caplog.records if each.levelno >= logging.WARNING]


def test_what_follows_a_follower_follows_its_leader(tmp_path, caplog):
    urdf = load_urdf(urdf_of(tmp_path, *rows("a_joint", "b_joint", "c_joint")))
    urdf.model.update_cfg({"a_joint": 0.05})
    for name, turn in (("b", 0.2), ("c", 0.5), ("d", 1.1)):
        assert turn_of(urdf, name) == pytest.approx(turn)
        assert urdf.joint(f"{name}_joint").mimic.joint == "a_joint"
    assert not caplog.records


def test_what_is_fixed_follows_nothing_and_is_not_told(tmp_path, caplog):
    parts = link("b"), joint("b", "base", kind="fixed", more=follows("nobody"))
    path, notes = urdf_of(tmp_path, *rows(), *parts), list[str]()
    assert checked_urdf(path, read_urdf(path, notes)).joint("b_joint").mimic is None
    assert not notes
    assert not caplog.records


def test_a_slide_is_held_along_its_axis(tmp_path):
    slide = joint("b", "base", "0 0 0.1", "0 2 0", "prismatic", follows("nobody"))
    path = urdf_of(tmp_path, *rows(), link("b"), slide)
    place = load_urdf(path).model.get_transform("b", "base")[:3, 3]
    np.testing.assert_allclose(place, [0, 0.1, 0.1])
    assert led(read_urdf(path)) == []
