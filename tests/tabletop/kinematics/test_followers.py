"""Joints that follow others, or none that moves."""

import logging

import numpy as np
import pytest
from small_urdfs import LIMIT, box, joint, link, urdf_of

from cgtorch.tabletop.kinematics.followers import first_leads, led
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


def slides(*followers, kind="prismatic", more=LIMIT, beside=""):
    """Links a, b, ... on each other, whose joints follow the last, which has a kind and limit."""
    parts, above = [link("base", box())], "base"
    for name, (factor, offset) in zip("abc", followers, strict=False):
        parts += [
            link(name),
            joint(name, above, kind="prismatic", more=follows("z_joint", factor, offset)),
        ]
        above = name
    return [*parts, link("z"), joint("z", above, kind=kind, more=more), beside]


def test_the_first_of_a_telescope_leads_the_others_as_they_moved_before(tmp_path, caplog):
    caplog.set_level(logging.ERROR)
    wide = LIMIT.replace('"-1"', '"0"').replace('"1"', '"0.5"', 1)
    beside = link("d") + joint("d", "base", kind="prismatic", more=follows("z_joint", 3, 0.2))
    path = urdf_of(tmp_path, *slides((-2, 0.1), (1, 0), more=wide, beside=beside))
    before, notes = load_urdf(path), list[str]()
    after = checked_urdf(path, read_urdf(path, notes))
    assert notes == [
        "'a_joint' leads 'z_joint' now, which it followed in the URDF, as it is before that"
    ]
    limit = after.joint("a_joint").limit
    assert (limit.lower, limit.upper) == pytest.approx((-0.9, 0.1))
    assert {after.joint(f"{name}_joint").mimic.joint for name in "bzd"} == {"a_joint"}
    for share in (0, 0.3, 0.5):
        before.model.update_cfg({"z_joint": share})
        after.model.update_cfg({"a_joint": 0.1 - 2 * share})
        for name in "abzd":
            poses = (each.model.get_transform(name, "base") for each in (before, after))
            np.testing.assert_allclose(*poses, atol=1e-9)


@pytest.mark.parametrize(
    "parts",
    [
        slides((1, 0), kind="continuous", more=""),  # without ends that the first could have
        slides((0, 0.1)),  # which does not move
        rows("a_joint"),  # beside each other
    ],
)
def test_what_cannot_lead_or_is_not_before_follows_as_it_did(tmp_path, parts):
    path, notes = urdf_of(tmp_path, *parts), list[str]()
    root = read_urdf(path, notes)
    assert notes == []
    assert first_leads(root) == {}
