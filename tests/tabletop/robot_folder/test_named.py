"""Arms that a user or an SRDF names, from any link to any other below it."""

import pytest
from small_urdfs import chain, fingers, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.description import Arm
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.named import chains_of_groups
from cgtorch.tabletop.robot_folder.proposal import Wishes
from cgtorch.tabletop.robot_folder.structure import Structure

LIFT = link("lift") + joint("lift", "base", "0 0 1", "0 0 1", "prismatic")
SIDES = ("p", 0.3), ("q", -0.3)
TWO = [chain(name, 6, "lift", first=f"0 {y} 0.1") for name, y in SIDES]
HANDS = [fingers(f"hand_{name}", f"{name}5") for name, _ in SIDES]
JOINTS = {name: [f"{name}{i}_joint" for i in range(6)] for name, _ in SIDES}


def test_what_moves_all_hands_of_groups_or_lifts_them_is_the_torso(tmp_path):
    urdf = load_urdf(urdf_of(tmp_path, link("base"), LIFT, *TWO))
    structure = Structure(urdf, "base")

    def found(*hands):
        arms = [Arm(hand, "base", hand) for hand in hands]
        shared, own = chains_of_groups(structure, arms, hands)
        return [each.name for each in shared], [[each.name for each in one] for one in own]

    one, other = JOINTS.values()
    assert found("p5", "q5") == (["lift_joint"], [one, other])
    assert found("p5") == (["lift_joint"], [one])
    assert found("p3") == ([], [["lift_joint", *one[:4]]])  # which needs the lift
    with pytest.raises(RobotError, match="arm 'p3' has no joints of its own between"):
        found("p5", "p3")


@pytest.mark.parametrize(
    ("arm", "joints", "torso"),
    [
        (Arm("arm", "base", "p5"), ["lift_joint", *JOINTS["p"]], None),  # and what lifts it
        pytest.param(
            Arm("arm", "lift", "p5"), JOINTS["p"], "lift_joint", marks=pytest.mark.hostile
        ),
        (Arm("arm", "p1", "p5"), JOINTS["p"][2:], "lift_joint"),  # from within the one proposed
        pytest.param(
            Arm("arm", "p0", "p3"), JOINTS["p"][1:4], "lift_joint", marks=pytest.mark.hostile
        ),
    ],
)
def test_a_named_arm_has_all_joints_between_its_links_and_no_other(tmp_path, arm, joints, torso):
    path = urdf_of(tmp_path, link("base"), LIFT, *TWO, *HANDS)
    robot = make_robot_folder(path, tmp_path / "made", Wishes(arms=(arm,))).robot
    assert list(robot.arms[0].joint_names) == joints
    words = robot.description
    assert words.torso_joint == torso
    assert not words.held.keys() & set(joints)
    assert set(JOINTS["p"]) <= words.held.keys() | set(joints)


def test_a_torso_that_is_a_joint_of_a_named_arm_is_refused(tmp_path):
    path = urdf_of(tmp_path, link("base"), LIFT, *TWO)
    wishes = Wishes(arms=(Arm("arm", "base", "p5"),), torso_joint="lift_joint", torso_position=0.0)
    with pytest.raises(RobotError, match=r"'lift_joint' is named .* but moves an arm"):
        make_robot_folder(path, tmp_path / "made", wishes)


def test_a_joint_of_two_named_arms_is_refused(tmp_path):
    path = urdf_of(tmp_path, link("base"), LIFT, *TWO)
    wishes = Wishes(arms=tuple(Arm(name, "base", f"{name}5") for name, _ in SIDES))
    with pytest.raises(RobotError, match="'lift_joint' moves both arms 'p' and 'q': begin both"):
        make_robot_folder(path, tmp_path / "made", wishes)
