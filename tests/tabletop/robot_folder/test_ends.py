"""What is at the ends of chains: fingers, feet that look like jaws, and gears."""

from small_urdfs import box, chain, fingers, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.chains import chains_of
from cgtorch.tabletop.robot_folder.structure import Structure

BASE, PELVIS = link("base", box("0.3 0.3 1", "0 0 0.5")), link("base", box("0.3 0.3 0.2"))
SIDES, HIPS = ("0 0.3 0", "0 -0.3 0"), ("0 0.1 -0.2", "0 -0.1 -0.2")
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


def test_what_carries_two_joints_is_no_finger(tmp_path):
    """A gear beside the last joint of a wrist, which carries a gripper."""
    arm = chain("arm", 6, "base", first="0 0 0.9") + fingers("gripper", "arm5")
    gear = link("gear", box("0.01 0.01 0.01")) + joint("gear", "arm4", "0 0.02 0")
    assert arms(structure_of(tmp_path, BASE, arm, gear)) == {"arm5": 6}


def test_a_joint_that_is_called_a_finger_is_one(tmp_path):
    arm = chain("arm", 6, "base", first="0 0 0.9")
    for name, found in (("finger_", {"arm5": 6}), ("wrist_", {"wrist_1": 8})):
        series = chain(name, 2, "arm5", "0.03 0 0")
        assert arms(structure_of(tmp_path, BASE, arm, series)) == found
