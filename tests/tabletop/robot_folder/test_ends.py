"""What is at the ends of chains: fingers, feet that look like jaws, and gears."""

import pytest
from small_urdfs import LIMIT, box, chain, fingers, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.chains import chains_of, told
from cgtorch.tabletop.robot_folder.structure import Structure

BASE, PELVIS = link("base", box("0.3 0.3 1", "0 0 0.5")), link("base", box("0.3 0.3 0.2"))
SIDES, HIPS = ("0 0.3 0", "0 -0.3 0"), ("0 0.1 -0.2", "0 -0.1 -0.2")
DOWN = "0 0 -0.1"
LEGS = "".join(chain(f"leg{i}_", 6, "base", "0 0 -0.1", hip) for i, hip in enumerate(HIPS))


def structure_of(tmp_path, *parts):
    urdf = load_urdf(urdf_of(tmp_path, *parts))
    return Structure(urdf, urdf.model.base_link)


def arms(structure):
    return {c.link: len(c.own) for c in chains_of(structure) if c.kind == "arm"}


def test_feet_that_look_like_jaws_are_feet_where_others_are_arms(tmp_path):
    """Each foot turns against the shank, by one joint, and the arms end in nothing."""
    few = [chain(f"arm{i}_", 5, "base", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    feet = "".join(
        link(f"foot{i}", box("0.02 0.02 0.05", "0 0 -0.025"))
        + joint(f"foot{i}", f"leg{i}_5", "0.02 0 0", "1 0 0")
        for i in range(2)
    )
    structure = structure_of(tmp_path, PELVIS, *few, LEGS, feet)
    assert all(c.fingers for c in chains_of(structure) if c.link.startswith("leg"))
    assert arms(structure) == {"arm0_4": 5, "arm1_4": 5}


def test_hands_that_hang_to_the_floor_are_hands_unless_they_are_feet_beside_two_arms(tmp_path):
    """Jaws, beside a single chain that ends in nothing, and fingers, beside two of them."""
    jaws = "".join(
        link(f"jaw{i}", box("0.02 0.02 0.05", "0 0 -0.025"))
        + joint(f"jaw{i}", f"leg{i}_5", "0.02 0 0", "1 0 0")
        for i in range(2)
    )
    few = [chain(f"other{i}_", 5, "base", "0.1 0 0", side) for i, side in enumerate(SIDES)]
    both = {"leg0_5": 6, "leg1_5": 6}
    assert arms(structure_of(tmp_path, PELVIS, few[0], LEGS, jaws)) == both
    hands = [fingers(f"hand{i}", f"leg{i}_5", "0 {} -0.02") for i in range(2)]
    assert arms(structure_of(tmp_path, PELVIS, *few, LEGS, *hands)) == both


@pytest.mark.parametrize("count", [3, 4])
def test_a_finger_is_no_joint_of_an_arm_that_lacks_one(tmp_path, count):
    arm = chain("arm", count, "base", first="0 0 0.9") + fingers("jaw", f"arm{count - 1}")
    (found,) = chains_of(structure_of(tmp_path, BASE, arm))
    assert (found.link, len(found.own), found.fingers) == (f"arm{count - 1}", count, True)
    assert found.kind == ("arm" if count == 4 else "too few joints")


@pytest.mark.parametrize("size", [0.55, 0.65])
def test_claws_of_a_large_arm_are_large(tmp_path, size):
    """A fifth of its length, 3 m, at most."""
    arm = chain("arm", 6, "base", "0 0 0.6", first="0 0 0.9")
    claws = "".join(
        link(f"claw{y}", box("0.02 0.02 0.02", f"0 0 {size}"))
        + joint(f"claw{y}", "arm5", f"0 {y} 0")
        for y in (0.2, -0.2)
    )
    structure = structure_of(tmp_path, BASE, arm, claws)
    assert arms(structure) == ({"arm5": 6} if size == 0.55 else {"claw0.2": 7})


@pytest.mark.parametrize("follows", [False, True])
def test_claws_of_which_one_follows_the_other_may_be_large(tmp_path, follows):
    """Half as long as their arm, 1 m; on three joints they make no arm of four."""
    more = {1: LIMIT, -1: LIMIT + follows * '<mimic joint="claw1_joint" multiplier="-1"/>'}
    arm = chain("arm", 3, "base", "0 0 0.5", first="0 0 0.9")
    claws = "".join(
        link(f"claw{side}", box("0.02 0.02 0.4", "0 0 0.2"))
        + joint(f"claw{side}", "arm2", f"0 {side / 10} 0", "1 0 0", more=more[side])
        for side in more
    )
    found = arms(structure_of(tmp_path, BASE, arm, claws))
    assert found == ({} if follows else {"claw1": 4})


@pytest.mark.parametrize(("axis", "kept"), [("0 1 0", 5), ("1 0 0", 4)])
def test_rods_beside_an_arm_make_no_torso_of_what_carries_both(tmp_path, axis, kept):
    """A linkage is written as two chains, of which one only moves in a plane."""
    arm = chain("arm", 5, "base", "0 0 0.2", first="0 0 0.9")
    rods = chain("rod", 2, "arm0", "0 0 0.2", first="0.1 0 0.2").replace("0 0 1", "0 1 0")
    rods += link("rod2") + joint("rod2", "rod1", "0 0 0.2", axis)
    found = arms(structure_of(tmp_path, BASE, arm, rods))
    assert found == {"arm4": kept}


def test_what_carries_two_joints_is_no_finger(tmp_path):
    """A gear beside the last joint of a wrist, which carries a gripper."""
    arm = chain("arm", 6, "base", first="0 0 0.9") + fingers("gripper", "arm5")
    gear = link("gear", box("0.01 0.01 0.01")) + joint("gear", "arm4", "0 0.02 0")
    assert arms(structure_of(tmp_path, BASE, arm, gear)) == {"arm5": 6}


def test_a_finger_may_have_two_tips_of_which_one_follows_the_other(tmp_path):
    arm = chain("arm", 6, "base", first="0 0 0.9") + fingers("hand", "arm5")
    parts = [arm]
    for side in "ab":
        parts += [link(f"tip{i}{side}") for i in range(2)]
        parts.append(joint(f"tip0{side}", f"hand_{side}", "0 0 0.03"))
        follows = LIMIT + f'<mimic joint="tip0{side}_joint"/>'
        parts.append(joint(f"tip1{side}", f"hand_{side}", "0 0 0.03", more=follows))
    (found,) = chains_of(structure_of(tmp_path, BASE, *parts))
    assert (found.link, found.fingers) == ("arm5", True)


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
@pytest.mark.parametrize(("long", "jaw"), [(0.07, True), (0.05, False)])
def test_a_jaw_may_be_closed_at_rest(tmp_path, long, jaw, kind):
    """Beside a part of the hand that reaches far enough towards its tip at rest alone."""
    hand = box() + box(f"0.02 0.02 {long}", f"0 -0.03 {0.05 + long / 2}")
    last = link("jaw", box("0.02 0.02 0.1", "0 0 0.05"))
    last += joint("jaw", "hand", "0 0 0.05", "0 1 0", kind)
    arm = chain("arm", 5, "base", first="0 0 1") + link("hand", hand) + joint("hand", "arm4")
    found = arms(structure_of(tmp_path, BASE, arm, last))
    assert found == ({"hand": 6} if jaw else {"jaw": 7})


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("low", "high", "jaw"), [(-1, 0, True), (0, 1, False), (-0.4, 1, False)])
def test_an_open_jaw_closes_by_turning_either_way(tmp_path, low, high, jaw, way):
    hand = box() + box("0.02 0.02 0.12", "-0.03 0 0.07")
    low, high = sorted((way * low, way * high))
    limit = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
    last = link("jaw", box("0.06 0.02 0.06", "0.05 0 0.05"))
    last += joint("jaw", "hand", "0 0 0.05", f"0 {way} 0", more=limit)
    arm = chain("arm", 5, "base", first="0 0 1") + link("hand", hand) + joint("hand", "arm4")
    found = arms(structure_of(tmp_path, BASE, arm, last))
    assert found == ({"hand": 6} if jaw else {"jaw": 7})


@pytest.mark.parametrize("side", [1, -1])
def test_what_closes_after_a_quarter_of_a_turn_is_no_jaw(tmp_path, side):
    hand = box("0.02 0.02 0.02") + box("0.02 0.02 0.065", "0 -0.03 0.0825")
    limit = LIMIT.replace("1", "1.55", 2)
    last = link("last", box("0.1 0.02 0.02", f"{0.05 * side} 0 0"))
    last += joint("last", "hand", "0 0 0.05", "0 1 0", more=limit)
    arm = chain("arm", 5, "base", first="0 0 1") + link("hand", hand) + joint("hand", "arm4")
    assert arms(structure_of(tmp_path, BASE, arm, last)) == {"last": 7}


def test_a_joint_that_is_called_a_finger_is_one(tmp_path):
    arm = chain("arm", 6, "base", first="0 0 0.9")
    names = ("finger_", {"arm5": 6}), ("RightThumb", {"arm5": 6}), ("wrist_", {"wrist_1": 8})
    for name, found in names:
        series = chain(name, 2, "arm5", "0.03 0 0")
        assert arms(structure_of(tmp_path, BASE, arm, series)) == found


def test_what_moves_nothing_that_is_seen_beside_a_joint_is_no_finger(tmp_path):
    """Joints beside the wrist's, by which a simulator models their stiffness."""
    arm = chain("arm", 7, "base", first="0 0 0.9")
    stiff = "".join(
        link(f"stiff{i}", "") + joint(f"stiff{i}", f"arm{i}", axis="0 1 0") for i in range(6)
    )
    assert arms(structure_of(tmp_path, BASE, arm, stiff)) == {"arm6": 7}
    hand = fingers("hand", "arm6").replace(box(), "")
    assert arms(structure_of(tmp_path, BASE, arm, hand)) == {"arm6": 7}  # where none is seen


@pytest.mark.parametrize(("at", "jaw"), [("0 -0.1 0.05", True), ("0 -0.1 0", False)])
def test_a_sliding_jaw_may_begin_far_along_its_way(tmp_path, at, jaw):
    """Its frame is beside it, along the axis by which it closes."""
    arm = chain("arm", 5, "base", first="0 0 0.9") + link("frame", "") + joint("frame", "arm4")
    slide = link("slide", box("0.02 0.02 0.06", at)) + joint(
        "slide", "arm4", "0 0.12 0.01", "0 1 0", "prismatic", LIMIT.replace("1", "0.02")
    )
    wide = arm.replace(box(), box() + box("0.02 0.1 0.2"))
    found = arms(structure_of(tmp_path, BASE, wide, slide))
    assert found == ({"arm4": 5} if jaw else {"slide": 6})


@pytest.mark.parametrize(("same", "jaw"), [(3, True), (2, False)])
def test_a_jaw_may_turn_as_far_as_most_joints_of_its_arm(tmp_path, same, jaw):
    """As where all servos have the range of their kind, and some are narrowed."""
    ends = ["-2 2"] * same + ["-1.5 2"] * (5 - same)
    arm = chain("arm", 5, "base", first="0 0 0.9")
    for i, words in enumerate(ends):
        low, high = words.split()
        part, found = f'<joint name="arm{i}_joint"', LIMIT.replace('"-1"', f'"{low}"')
        begin, end = arm.split(part)
        arm = begin + part + end.replace(LIMIT, found.replace('upper="1"', f'upper="{high}"'), 1)
    hand = link("jaw", box("0.02 0.02 0.1", "0.01 0 0.06")) + joint(
        "jaw",
        "arm4",
        "0 0 0.05",
        "0 1 0",
        more=LIMIT.replace('r="-1"', 'r="-2"').replace('upper="1"', 'upper="2"'),
    )
    wide = arm.replace(box(), box() + box("0.02 0.02 0.3", "-0.03 0 0.15"))
    found = arms(structure_of(tmp_path, BASE, wide, hand))
    assert found == ({"arm4": 5} if jaw else {"jaw": 6})


def test_legs_with_long_feet_and_wide_hips_stand(tmp_path):
    """The floor is as far below a hip as half of the leg's reach: there is no arm."""
    feet = "".join(
        link(f"foot{i}", box("0.8 0.1 0.02", "0.1 0 0")) + joint(f"foot{i}", f"leg{i}_5", DOWN)
        for i in range(2)
    )
    few = "".join(chain(f"arm{i}_", 3, "base", "0.1 0 0", side) for i, side in enumerate(SIDES))
    assert arms(structure_of(tmp_path, PELVIS, few, LEGS, feet)) == {}


def test_heads_of_two_joints_are_told_and_casters_are_not(tmp_path):
    arm = chain("arm", 6, "base", first="0.1 0 0.9") + fingers("hand", "arm5")
    caster = "".join(
        link(f"caster{i}") + joint(f"caster{i}", above, kind="continuous", more="")
        for i, above in enumerate(("base", "caster0"))
    )
    head = chain("head", 2, "base", first="-0.1 0 1.2")
    said = told(chains_of(structure_of(tmp_path, BASE, arm, head, caster)))
    assert said == "2 joints from 'head0_joint' to 'head1_joint' (too few joints)"
