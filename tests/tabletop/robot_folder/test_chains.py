"""Which chains are arms: by where they begin and what they end in, not by height and joints."""

import math
from types import SimpleNamespace

import pytest
from small_urdfs import LIMIT, box, chain, fingers, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.chains import (
    BARE,
    BRANCH,
    CLOSE,
    LEG,
    SHORT,
    _freedom,
    _reach,
    _within,
    chains_of,
    lowest,
)
from cgtorch.tabletop.robot_folder.fingers import depth_of, extent
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.solid import solid
from cgtorch.tabletop.robot_folder.structure import Structure


def structure_of(tmp_path, *parts):
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    return Structure(urdf, urdf.model.base_link)


def kinds(structure):
    return {chain.link: chain.kind for chain in chains_of(structure)}


def arms(structure):
    return {c.link: len(c.own) for c in chains_of(structure) if c.kind == "arm"}


BASE, PELVIS = link("base", box("0.3 0.3 1", "0 0 0.5")), link("base", box("0.3 0.3 0.2"))
DOWN, HIPS = "0 0 -0.1", ("0 0.1 -0.2", "0 -0.1 -0.2")
LEGS = "".join(chain(f"leg{i}_", 6, "base", DOWN, hip) for i, hip in enumerate(HIPS))
SIDES = ("0 0.3 0", "0 -0.3 0")


def test_hands_that_hang_below_a_raised_base_are_no_feet(tmp_path):
    two = (
        chain(f"arm{i}_", 6, "base", DOWN, side) + fingers(f"hand{i}", f"arm{i}_5")
        for i, side in enumerate(SIDES)
    )
    neck = chain("neck", 2, "base", first="0 0 0.3")
    assert arms(structure_of(tmp_path, PELVIS, *two, neck)) == {"arm0_5": 6, "arm1_5": 6}


def test_joints_count_after_the_torso(tmp_path):
    torso = chain("waist", 3, "base")
    two = [chain(f"arm{i}_", 6, "waist2", DOWN, side) for i, side in enumerate(SIDES)]
    neck = chain("neck", 3, "waist2", "0 0 0.2")
    structure = structure_of(tmp_path, BASE, torso, *two, neck)
    assert kinds(structure) == {"arm0_5": "arm", "arm1_5": "arm", "neck2": SHORT}
    assert arms(structure) == {"arm0_5": 6, "arm1_5": 6}
    ends = [chain(f"arm{i}_", 3, "waist2", DOWN, side) for i, side in enumerate(SIDES)]
    assert arms(structure_of(tmp_path, BASE, torso, *ends)) == {}


def test_legs_hang_where_arms_have_a_torso_or_reach_the_floor(tmp_path):
    two = [chain(f"arm{i}_", 6, "waist0", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    raised = [chain(f"leg{i}_", 6, "base", "0.1 0 0", hip) for i, hip in enumerate(HIPS)]
    for legs in (LEGS, "".join(raised)):
        found = kinds(structure_of(tmp_path, PELVIS, chain("waist", 1, "base"), *two, legs))
        assert found == {"arm0_5": "arm", "arm1_5": "arm", "leg0_5": LEG, "leg1_5": LEG}
    # Without a torso, what stands are legs, and only one thing that hangs down is an arm.
    plain = [chain(f"arm{i}_", 6, "base", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    assert kinds(structure_of(tmp_path, PELVIS, *plain, LEGS))["leg0_5"] == LEG
    assert kinds(structure_of(tmp_path, PELVIS, *plain, LEGS))["arm0_5"] == "arm"
    assert arms(structure_of(tmp_path, PELVIS, chain("a", 6, "base", DOWN, "0 0 -0.2"))) == {
        "a5": 6
    }
    one = chain("b", 6, "base", "0.1 0 0", SIDES[0]), chain("a", 6, "base", DOWN, HIPS[1])
    assert arms(structure_of(tmp_path, PELVIS, *one)) == {"b5": 6, "a5": 6}  # it cannot stand
    stand = (chain(f"a{i}_", 6, "base", "0.1 0 -0.01", side) for i, side in enumerate(SIDES))
    low = link("base", box("0.3 0.3 0.05", "0 0 0.1"))
    assert len(arms(structure_of(tmp_path, low, *stand))) == 2  # which lead to the side


def test_arms_have_four_joints_where_none_has_more(tmp_path):
    two = [chain(f"arm{i}_", 4, "waist0", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    waist = chain("waist", 1, "base")
    assert arms(structure_of(tmp_path, PELVIS, waist, *two, LEGS)) == {"arm0_3": 4, "arm1_3": 4}
    longer = chain("long", 6, "base", "0.1 0 0", "0 0 0.2")
    assert "arm0_3" not in arms(structure_of(tmp_path, BASE, waist, *two, longer))
    hand = chain("arm", 4, "base", first="0 0 0.9") + fingers("hand", "arm3")
    assert arms(structure_of(tmp_path, BASE, hand)) == {"arm3": 4}


def test_legs_may_hang_from_a_waist_and_may_have_wheels_or_claws(tmp_path):
    two = [chain(f"arm{i}_", 6, "base", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    both = {"arm0_5": "arm", "arm1_5": "arm"}
    waist = chain("waist", 1, "base", DOWN, "0 0 -0.1")
    hips = [chain(f"leg{i}_", 6, "waist0", DOWN, hip) for i, hip in enumerate(HIPS)]
    found = kinds(structure_of(tmp_path, PELVIS, *two, waist, *hips))
    assert found == {**both, "leg0_5": LEG, "leg1_5": LEG}
    few = [chain(f"arm{i}_", 4, "base", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    assert arms(structure_of(tmp_path, PELVIS, *few, waist, *hips)) == {"arm0_3": 4, "arm1_3": 4}
    leg = chain("leg", 6, "base", DOWN, "0 0 -0.2") + fingers("wheel", "leg5", "0 {} 0")
    rolls = leg.replace(
        '_joint" type="revolute"><parent link="leg5"',
        '_joint" type="continuous"><parent link="leg5"',
    )
    assert kinds(structure_of(tmp_path, PELVIS, *two, rolls)) == {**both, "leg5": LEG}
    claws = "".join(fingers(f"claw{i}", f"leg{i}_5", "0 {} -0.03") for i in range(2))
    hands = "".join(fingers(f"hand{i}", f"arm{i}_5", "0.05 {} 0") for i in range(2))
    found = kinds(structure_of(tmp_path, PELVIS, *two, LEGS, claws, hands))
    assert found == {**both, "leg0_5": LEG, "leg1_5": LEG}


def test_a_head_without_fingers_is_no_arm_where_others_have_some(tmp_path):
    hand = chain("arm", 6, "base", first="0 0.3 0.9") + fingers("hand", "arm5")
    neck = chain("neck", 5, "base", "0 0 0.1", "0 0 1")
    assert kinds(structure_of(tmp_path, BASE, hand, neck)) == {"arm5": "arm", "neck4": BARE}
    other = chain("arm", 6, "base", "0 0 0.3", "0 0.3 0.9")
    assert kinds(structure_of(tmp_path, BASE, other, neck)) == {"arm5": "arm", "neck4": CLOSE}


@pytest.mark.parametrize(
    ("shapes", "axis", "wide", "jaw"),
    [
        (box("0.02 0.02 0.1", "0.01 0 0.06"), "0 1 0", True, True),
        (box("0.02 0.02 0.1", "0.01 0 0.06", "visual"), "0 1 0", True, True),
        (box("0.02 0.02 0.1", "0.01 0.04 0.06"), "0 1 0", True, True),  # aside along its axis
        (box("0.02 0.02 0.1", "0.01 0.05 0.06"), "0 1 0", True, False),
        (box("0.02 0.02 0.1", "0.01 0 0.06"), "0 1 0", False, False),  # nothing to close against
        (box("0.02 0.02 0.1", "0 0 0.06"), "0 0 1", True, False),  # it turns about itself
        (box("0.05 0.05 0.05"), "0 1 0", True, False),  # it lies around its axis
        (box("0.02 0.02 0.4", "0.01 0 0.21"), "0 1 0", True, False),  # as long as a forearm
        ("", "0 1 0", True, True),  # it moves nothing
    ],
)
def test_a_jaw_closes_against_its_hand(tmp_path, shapes, axis, wide, jaw):
    hand = box() + (box("0.02 0.02 0.3", "-0.03 0 0.15") if wide else "")
    parts = BASE, chain("arm", 5, "base", first="0 0 1"), link("hand", hand), link("jaw", shapes)
    ends = joint("hand", "arm4"), joint("jaw", "hand", "0 0 0.05", axis)
    found = arms(structure_of(tmp_path, *parts, *ends))
    assert found == ({"hand": 6} if jaw else {"jaw": 7})


@pytest.mark.parametrize(("end", "others", "jaw"), [(1.58, 1, True), (1.6, 1, False), (3, 3, True)])
def test_a_jaw_turns_half_a_turn_at_most(tmp_path, end, others, jaw):
    """What turns farther is a wrist, unless all joints have that range, which then says nothing."""
    limit = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'

    def limited(parts, most):
        return parts.replace(LIMIT, limit.format(-most, most))

    hand = link("hand", box() + box("0.02 0.02 0.3", "-0.03 0 0.15")) + joint("hand", "arm4")
    last = link("jaw", box("0.02 0.02 0.1", "0.01 0 0.06")) + joint("jaw", "hand", axis="0 1 0")
    rest = limited(chain("arm", 5, "base", first="0 0 1") + hand, others)
    found = arms(structure_of(tmp_path, BASE, rest, limited(last, end)))
    assert found == ({"hand": 6} if jaw else {"jaw": 7})


@pytest.mark.parametrize(
    ("low", "high", "kind", "jaw"),
    [
        (-1, 1, "revolute", True),
        (-1, 0, "revolute", True),
        (0, 1, "revolute", False),  # it opens further only
        (-0.4, 1, "revolute", False),  # it cannot close
        (-1, 1, "prismatic", False),
        (0.1, 1, "revolute", False),  # its rest position is beyond its limits
    ],
)
def test_a_jaw_may_be_open_at_rest(tmp_path, low, high, kind, jaw):
    """By 45 degrees, where the finger of the hand reaches too little towards its tip."""
    limit = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
    hand = link("hand", box() + box("0.02 0.02 0.12", "-0.03 0 0.07")) + joint("hand", "arm4")
    open_at = joint("jaw", "hand", "0 0 0.05", "0 1 0", kind, limit)
    last = link("jaw", box("0.06 0.02 0.06", "0.05 0 0.05")) + open_at
    found = arms(structure_of(tmp_path, BASE, chain("arm", 5, "base", first="0 0 1"), hand, last))
    assert found == ({"hand": 6} if jaw else {"jaw": 7})


def test_a_camera_at_an_arm_and_joints_that_follow_change_nothing(tmp_path):
    arm = chain("arm", 6, "base", first="0 0 1")
    camera = chain("camera", 2, "arm3", "0 0 0.2", "0.1 0 0"), fingers("hand", "arm5")
    assert kinds(structure_of(tmp_path, BASE, arm, *camera)) == {"arm5": "arm", "camera1": BARE}
    camera = chain("camera", 2, "arm3", "0 0 0.02", "0 0 0", box("0.01 0.01 0.4"))
    assert kinds(structure_of(tmp_path, BASE, arm, camera)) == {"arm5": "arm", "camera1": BRANCH}
    follows = link("f") + joint("f", "arm5", more=f'<mimic joint="arm5_joint"/>{LIMIT}')
    assert arms(structure_of(tmp_path, BASE, arm, follows)) == {"arm5": 6}


def test_fingers_of_many_joints_are_no_arms(tmp_path):
    small = "0 0 0.015"
    hand = "".join(
        chain(f"f{i}_", 7, "arm5", small, f"0 {y} 0") for i, y in enumerate((0.02, -0.02))
    )
    structure = structure_of(tmp_path, BASE, chain("arm", 6, "base", first="0 0 1"), hand)
    assert arms(structure) == {"arm5": 6}


def test_what_hangs_from_a_joint_is_as_deep_and_as_far_as_its_longest_part(tmp_path):
    """Joints that follow others do not count, nor do fixed ones."""
    follows = f'<mimic joint="a_joint"/>{LIMIT}'
    parts = (
        link("a"), joint("a", "base"), link("b"), joint("b", "a", "0 0 0.2"), link("c"),
        joint("c", "b", "0 0.3 0"), link("d"), joint("d", "a", "0.1 0 0"), link("e"),
        joint("e", "d", more=follows), link("f"), joint("f", "c", kind="fixed", more=""),
    )  # fmt: skip
    structure = structure_of(tmp_path, BASE, *parts)
    above = structure.above
    assert [depth_of(structure, above[name]) for name in "abcde"] == [3, 2, 1, 1, 0]
    half = 0.025
    farthest = math.sqrt(half**2 + (0.3 + half) ** 2 + (0.2 + 0.1 + half) ** 2)
    assert extent(structure, "a") == pytest.approx(farthest)
    assert extent(structure, "e") == pytest.approx(half * math.sqrt(3))
    assert lowest(structure, ["a", "d"]) == pytest.approx(0.1 - half)
    assert lowest(structure, []) == math.inf
    own = [above[name] for name in "abc"]
    chain = SimpleNamespace(own=own, link="c")
    assert _reach(structure, chain) == pytest.approx(0.2 + 0.3 + extent(structure, "c"))


def test_a_joint_is_within_its_range_or_a_turn(tmp_path):
    limit = SimpleNamespace(lower=-1.0, upper=3.0)
    assert _within(SimpleNamespace(type="revolute", limit=limit), 0.25) == 0.0
    assert _within(SimpleNamespace(type="continuous"), 0.25) == pytest.approx(math.pi / 2)


def test_what_joints_can_move_is_counted_where_they_are_not_in_one_line(tmp_path):
    """And afterwards they are where they were."""
    slides = "".join(
        link(f"s{i}") + joint(f"s{i}", f"s{i - 1}" if i else "base", "0 0 0.1", axis, "prismatic")
        for i, axis in enumerate(("1 0 0", "1 0 0", "0 1 0"))
    )
    structure = structure_of(tmp_path, BASE, slides, chain("arm", 3, "s2"))
    structure.urdf.model.update_cfg({"s0_joint": 0.25})
    before = structure.pose("arm2")
    path = structure.path("arm2")
    assert [_freedom(structure, path[:k]) for k in range(1, 7)] == [1, 1, 2, 3, 4, 5]
    assert (structure.pose("arm2") == before).all()


def test_slides_of_a_virtual_base_belong_to_no_arm(tmp_path):
    drive = (
        link("odom", ""), link("x", ""), link("y", ""),
        joint("x", "odom", "0 0 0", "1 0 0", "prismatic"),
        joint("y", "x", "0 0 0", "0 1 0", "prismatic"), joint("base", "y", "0 0 0"),
    )  # fmt: skip
    arm = chain("arm", 6, "base", first="0.1 0 1")
    urdf = structure_of(tmp_path, *drive, BASE, arm).urdf
    found = propose(urdf, Wishes())
    assert [arm.base_link for arm in found.words.arms] == ["base"]
    assert found.words.base_frame == "base"
    assert any("x_joint, y_joint, base_joint are taken for how the base" in n for n in found.notes)


def test_a_telescope_needs_the_lift_below_it(tmp_path):
    lift = link("lift") + joint("lift", "base", "0 0 1", "0 0 1", "prismatic")
    draws = "".join(
        link(f"l{i}")
        + joint(f"l{i}", f"l{i - 1}" if i else "lift", "0.1 0 0", "1 0 0", "prismatic")
        for i in range(4)
    )
    wrist = link("yaw") + joint("yaw", "l3") + fingers("hand", "yaw")
    assert arms(structure_of(tmp_path, BASE, lift, draws, wrist)) == {"yaw": 6}
    two = draws.partition(link("l2"))[0]
    for joints, own in ((3, 6), (4, 6)):  # of which two draw out as one
        wrist = chain("wrist", joints, "l1", "0.1 0 0") + fingers("hand", f"wrist{joints - 1}")
        assert arms(structure_of(tmp_path, BASE, lift, two, wrist)) == {f"wrist{joints - 1}": own}
    wrist = chain("wrist", 6, "lift", "0.1 0 0") + fingers("hand", "wrist5")
    assert arms(structure_of(tmp_path, BASE, lift, wrist)) == {"wrist5": 6}


def test_a_turn_and_a_slide_drive_a_base_too(tmp_path):
    drive = (
        link("odom", ""), link("turn", ""), joint("turn", "odom", "0 0 0"),
        joint("base", "turn", "0 0 0", "1 0 0", "prismatic"),
    )  # fmt: skip
    found = propose(structure_of(tmp_path, *drive, BASE, chain("arm", 6, "base")).urdf, Wishes())
    assert [arm.base_link for arm in found.words.arms] == ["base"]


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_a_joint_that_is_free_drives_a_base_unless_something_hangs_beside_it(tmp_path, kind):
    free = link("odom", "") + joint("base", "odom", "0 0 0", kind=kind, more="")
    parts = free, BASE, chain("arm", 6, "base")
    found = propose(structure_of(tmp_path, *parts).urdf, Wishes())
    assert found.words.base_frame == "base"
    assert any(note.startswith("base_joint is taken for how the base") for note in found.notes)
    beside = link("beside", "") + joint("beside", "odom", kind="fixed", more="")
    found = propose(structure_of(tmp_path, *parts, beside).urdf, Wishes())
    assert found.words.base_frame == "odom"


def test_what_is_no_arm_is_told(tmp_path):
    with pytest.raises(RobotError, match=r"6 joints from 'leg0_0_joint' to 'leg0_5_joint' \(a leg"):
        propose(structure_of(tmp_path, PELVIS, LEGS).urdf, Wishes())
    arm = chain("arm", 6, "base", first="0.2 0 0.3")
    notes = propose(structure_of(tmp_path, PELVIS, LEGS, arm).urdf, Wishes()).notes
    assert any(note.startswith("no arms: 6 joints from 'leg0_0_joint'") for note in notes)


def test_sides_are_those_of_the_links_names(tmp_path):
    for one, other in (("LArm", "RArm"), ("left_arm", "right_arm"), ("arm_l_", "arm_r_")):
        two = chain(one, 6, "base", DOWN, "0 -0.3 0.8"), chain(other, 6, "base", DOWN, "0 0.3 0.8")
        words = propose(structure_of(tmp_path, BASE, *two).urdf, Wishes()).words
        assert [(arm.name, arm.tool_frame[:5]) for arm in words.arms] == [
            ("left", "left_"),
            ("right", "right"),
        ]


def written(tmp_path, *parts):
    return structure_of(tmp_path, *parts).urdf.path


def test_an_arm_without_shapes_is_told_and_visual_shapes_are_taken(tmp_path):
    bare = link("base", "") + chain("arm", 6, "base", shapes="")
    with pytest.raises(
        RobotError, match=r"nothing of arm 'arm', from joint 'arm0_joint' on, has a"
    ):
        make_robot_folder(written(tmp_path, bare), tmp_path / "bare")
    seen = box("0.05 0.05 0.1", kind="visual")
    parts = link("base", box("0.2 0.2 0.5", "0 0 0.25", "visual"))
    parts += chain("arm", 6, "base", "0 0 0.15", "0 0 0.5", seen)
    plain, notes = solid(structure_of(tmp_path, parts).urdf)
    assert any("its visual shapes are taken" in note for note in notes)
    assert propose(plain, Wishes()).words.footprint == (-0.1, 0.1, -0.1, 0.1)
    first = BASE + chain("arm", 3, "base", first="0 0 1") + chain("far", 3, "arm2", shapes="")
    assert propose(structure_of(tmp_path, first).urdf, Wishes()).words.arms


def test_why_nothing_is_reached_is_told_with_a_table_that_suits(tmp_path):
    short = link("base", box("0.1 0.1 0.1", "0 0 0.05"))
    arm = "".join(
        link(f"a{i}", box("0.03 0.03 0.03"))
        + joint(f"a{i}", f"a{i - 1}" if i else "base", f"{0.09 if i else 0} 0 {0 if i else 0.25}",
                axis, more=LIMIT.replace("1", "3", 2))
        for i, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "1 0 0"))
    )  # fmt: skip
    made = make_robot_folder(written(tmp_path, short, arm), tmp_path / "made").reached
    assert not made.grasps.any()
    assert "m long from its shoulder, 0.25 m high, and the nearest object" in made.why
    assert "; " in made.why
