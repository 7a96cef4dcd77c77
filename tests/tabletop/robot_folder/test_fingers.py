"""What is a finger, and hands that no arm carries."""

import pytest
from small_urdfs import box, chain, fingers, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.chains import chains_of
from cgtorch.tabletop.robot_folder.fingers import is_finger
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.structure import Structure

BASE = link("base", box("0.3 0.3 1", "0 0 0.5"))
PALM = link("palm", box("0.02 0.08 0.08"))
SMALL = box("0.01 0.01 0.01")


def structure_of(tmp_path, *parts):
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    return Structure(urdf, urdf.model.base_link)


def kinds(structure):
    return {chain.link: chain.kind for chain in chains_of(structure)}


def hand(above, counts=(4, 4, 4, 5, 5), name="f{}_", step="0.03 0 0"):
    """Fingers side by side, of some joints."""
    each = enumerate(zip(counts, (-0.04, -0.02, 0, 0.02, 0.04), strict=False))
    return "".join(
        chain(name.format(i), count, above, step, f"0 {y} 0.04", SMALL) for i, (count, y) in each
    )


@pytest.mark.parametrize(
    ("joints", "far", "finger"),
    [
        (1, 0.3, True), (4, 0.3, True), (4, 0.301, False), (5, 0.3, False), (5, 0.2, True),
        (9, 0.2, True), (9, 0.201, False), (10, 0.2, False), (10, 0.1, False),
    ],
)  # fmt: skip
def test_a_finger_is_short_and_has_few_joints(tmp_path, joints, far, finger):
    parts = [
        link(f"f{i}", "") + joint(f"f{i}", f"f{i - 1}" if i else "base", "0 0 0")
        for i in range(joints)
    ]
    tip = link("tip", "") + joint("tip", f"f{joints - 1}", f"0 0 {far}", kind="fixed", more="")
    structure = structure_of(tmp_path, BASE, *parts, tip)
    assert is_finger(structure, structure.above["f0"]) == finger


@pytest.mark.parametrize("counts", [(4, 4, 4, 5, 5), (4, 3, 3), (9, 9, 9)])
def test_fingers_of_a_hand_that_no_arm_carries_are_no_arms(tmp_path, counts):
    """Also below a forearm, with a wrist of two joints."""
    step = "0.02 0 0" if max(counts) > 5 else "0.03 0 0"
    alone = structure_of(tmp_path, PALM, hand("palm", counts, step=step))
    wrist = chain("wrist", 2, "base", first="0 0 0.5")
    carried = structure_of(tmp_path, BASE, wrist, hand("wrist1", counts, step=step))
    for structure in (alone, carried):
        found = kinds(structure)
        assert len(found) == len(counts)
        assert set(found.values()) <= {"a finger", "too few joints"}
        assert "a finger" in found.values()


def test_short_arms_are_no_fingers_where_there_are_two_or_they_are_longer_or_others_stand(tmp_path):
    two = structure_of(tmp_path, PALM, hand("palm", (4, 4)))
    assert set(kinds(two).values()) == {"arm"}
    long = structure_of(tmp_path, PALM, hand("palm", (4, 4, 4), step="0.2 0 0"))
    assert set(kinds(long).values()) == {"arm"}
    legs = "".join(
        chain(f"leg{i}_", 3, "palm", "0 0 -0.03", f"0 {y} -0.04", SMALL)
        for i, y in enumerate((-0.04, 0.04))
    )
    walks = structure_of(tmp_path, PALM, legs, hand("palm", (4, 4, 4)))
    assert sorted(kinds(walks).values()) == ["arm"] * 3 + ["too few joints"] * 2


def test_fingers_are_told_by_the_names_of_their_first_joints(tmp_path):
    long = hand("palm", (3,), "finger{}_", "0.09 0 0") + hand("palm", (4,), "finger1{}_")
    urdf = load_urdf(urdf_of(tmp_path, PALM, long))
    with pytest.raises(RobotError) as caught:
        propose(urdf, Wishes())
    told = "what hangs from 'finger0_0_joint' (a finger); what hangs from 'finger10_0_joint' (a"
    assert told in str(caught.value)
    far = hand("palm", (3,), "finger{}_", "0.31 0 0")
    (found,) = chains_of(structure_of(tmp_path, PALM, far))
    assert (len(found.own), found.kind) == (2, "a finger")  # before its tip, which is a jaw
    carried = chain("arm", 5, "base", first="0 0 1") + fingers("finger", "arm4")
    assert kinds(structure_of(tmp_path, BASE, carried)) == {"arm4": "arm"}
