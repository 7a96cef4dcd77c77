"""Chains that looked longer than the arm is: fingers of two joints, a base that drives, legs."""

import pytest
from small_urdfs import box, chain, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.chains import chains_of
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.solid import sound_inertials
from cgtorch.tabletop.robot_folder.structure import Structure

BASE = link("base", box("0.3 0.3 1", "0 0 0.5"))
SIDES = ("0 0.1 {}", "0 -0.1 {}")


def arms(tmp_path, *parts):
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    found = chains_of(Structure(urdf, "base"))
    return {c.link: len(c.own) for c in found if c.kind == "arm"}


def two_of_two(names, second="0 0 0.05"):
    """Two chains of two joints on the link arm3."""
    return "".join(
        chain(name, 2, "arm3", at, f"0 {y} 0.03", box("0.02 0.02 0.04"))
        for name, y, at in zip(names, (0.03, -0.03), ("0 0 0.05", second), strict=True)
    )


@pytest.mark.parametrize(
    ("names", "second", "joints"),
    [
        (("p", "q"), "0 0 0.05", {"arm3": 4}),
        (("finger", "thumb"), "0 0 0.08", {"arm3": 4}),
        (("gear", "wrist"), "0 0 0.08", {"wrist1": 6}),
    ],
)
def test_two_fingers_of_two_joints_are_a_hand_if_alike_or_called_so(
    tmp_path, names, second, joints
):
    assert arms(tmp_path, BASE, chain("arm", 4, "base"), two_of_two(names, second)) == joints


@pytest.mark.parametrize("count", [3, 2])
def test_on_too_few_joints_they_make_no_arm(tmp_path, count):
    hand = two_of_two(("finger", "thumb")).replace("arm3", f"arm{count - 1}")
    assert not arms(tmp_path, BASE, chain("arm", count, "base"), hand)


@pytest.mark.parametrize("turn", ["revolute", "continuous"])
def test_a_base_drives_by_a_turn_and_a_slide_though_they_get_a_mass(tmp_path, turn):
    drive = (
        link("odom", ""), link("turned", ""), joint("turned", "odom", "0 0 0", kind=turn),
        joint("base", "turned", "0 0 0", "1 0 0", "prismatic"),
    )  # fmt: skip
    urdf = load_urdf(urdf_of(tmp_path, *drive, BASE, chain("arm", 7, "base")))
    found = propose(sound_inertials(urdf)[0], Wishes())
    assert [arm.base_link for arm in found.words.arms] == ["base"]
    assert "turned_joint, base_joint are taken for how the base drives" in found.notes[0]


def test_legs_hang_from_a_waist_that_leads_down_from_the_upper_body(tmp_path):
    upper = link("base", box("0.3 0.3 0.3"))
    waist = chain("waist", 3, "base", "0 0 -0.1")
    legs = [chain(f"leg{i}_", 6, "waist2", "0 0 -0.1", SIDES[i].format(-0.1)) for i in range(2)]
    short = [chain(f"arm{i}_", 3, "base", "0 0 -0.1", SIDES[i].format(0.1)) for i in range(2)]
    urdf = load_urdf(urdf_of(tmp_path, upper, waist, *legs, *short))
    with pytest.raises(RobotError, match=r"'leg0_0_joint' to 'leg0_5_joint' \(a leg\)"):
        propose(urdf, Wishes())
    # Arms that hang to the floor from a torso that leads up are none.
    waist = chain("waist", 3, "base", "0 0 0.1")
    assert (
        len(arms(tmp_path, link("base"), waist, *(leg.replace("-0.1", "-0.2") for leg in legs)))
        == 2
    )
