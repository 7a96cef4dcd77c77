"""Arms on both sides of a robot, one of which may have no fingers, and a head between them."""

import numpy as np
import pytest
from small_urdfs import box, chain, fingers, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.chains import ARM, BARE, CLOSE, HEAD, chains_of, told
from cgtorch.tabletop.robot_folder.pairs import Limb, heads, pairs
from cgtorch.tabletop.robot_folder.structure import Structure

BASE = link("base", box("0.3 0.3 1", "0 0 0.5"))
SIDES = {"left": 0.3, "right": -0.3}
FACE = link("face", box("0.12 0.1 0.02", "0.04 0 0.02")) + joint(
    "face", "neck4", "0 0 0.03", kind="fixed", more=""
)
JAW = (
    FACE
    + link("jaw", box("0.06 0.06 0.01", "0.03 0 0"))
    + joint("jaw", "face", "0.01 0 0", "0 1 0")
)
EYES = fingers("eye", "neck4", "0.05 {} 0.02")


def sides(*names, count=5, length="0 0 0.1"):
    return "".join(
        chain(name, count, "base", length, f"0 {SIDES[name]} 0.9") for name in names
    ) + "".join(fingers(f"{name}_hand", f"{name}{count - 1}") for name in names)


def neck(first="0 0 1", length="0 0 0.04", count=5):
    return chain("neck", count, "base", length, first, box("0.03 0.03 0.03"))


def kinds(tmp_path, *parts):
    urdf = load_urdf(urdf_of(tmp_path, BASE, *parts))
    found = chains_of(Structure(urdf, "base"))
    return {chain.link: chain.kind for chain in found}, told(found)


@pytest.mark.parametrize("face", [JAW, EYES])
def test_a_neck_with_a_jaw_or_eyes_between_two_arms_is_a_head(tmp_path, face):
    found, said = kinds(tmp_path, sides("left", "right"), neck(), face)
    assert found == {"left4": ARM, "right4": ARM, "neck4": HEAD}
    assert said == "5 joints from 'neck0_joint' to 'neck4_joint' (a head)"


def test_arms_without_hands_are_arms_beside_a_head_with_a_jaw(tmp_path):
    bare = "".join(chain(n, 5, "base", first=f"0 {y} 0.9") for n, y in SIDES.items())
    assert kinds(tmp_path, bare, neck(), JAW)[0] == {"left4": ARM, "right4": ARM, "neck4": HEAD}


@pytest.mark.parametrize(
    "third",
    [
        neck(length="0 0 0.1"),  # as long as the arms
        neck(first="0 0 0.8"),  # below them
        neck(first="0 0.2 1"),  # aside
    ],
)
def test_a_third_arm_is_no_head(tmp_path, third):
    found = kinds(tmp_path, sides("left", "right"), third, EYES)[0]
    assert found["neck4"] in (ARM, CLOSE)
    assert kinds(tmp_path, sides("left"), neck(), EYES)[0]["neck4"] != HEAD


def test_an_arm_without_fingers_is_one_if_it_is_as_that_on_the_other_side(tmp_path):
    cup = link("cup", box("0.03 0.03 0.08")) + joint("cup", "right4", kind="fixed", more="")
    bare = chain("right", 5, "base", first="0 -0.3 0.9")
    assert kinds(tmp_path, sides("left"), bare, cup)[0] == {"left4": ARM, "right4": ARM}
    for other in (
        chain("right", 6, "base", first="0 -0.3 0.9"),
        chain("right", 5, "base", "0 0 0.12", first="0 -0.3 0.9"),
        chain("right", 5, "base", first="0 -0.3 0.8"),
    ):
        assert BARE in kinds(tmp_path, sides("left"), other)[0].values()


def limb(y=0.0, z=1.0, joints=5, length=1.0, reach=1.2):
    return Limb(np.array([0.0, y, z]), joints, length, reach)


def test_limbs_are_compared_with_those_beside_them():
    left, right = limb(0.3), limb(-0.3, length=1.01)
    assert pairs([left, right, limb(0.0, joints=6)]) == [(0, 1)]
    assert pairs([left, left]) == []  # of one place
    assert heads([left, right, limb(0.02, 1.1, reach=0.8)]) == {2}
    assert heads([left, limb(0.02, 1.1, reach=0.8)]) == set()
    assert heads([left, right, limb(0.0, 1.1, reach=1.0)]) == set()
    assert heads([left, right, limb(0.0, 1.0, reach=0.8)]) == set()
