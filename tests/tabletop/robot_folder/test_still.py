"""Joints of hardly any range: those from which others hang are fixed where they are."""

from pathlib import Path

import numpy as np
import pytest
from small_urdfs import box, chain, fingers, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.still import without_still

BASE = link("base", box("0.3 0.3 0.6", "0 0 0.3"))
BOTH = '<limit lower="{0}" upper="{0}" effort="1" velocity="1"/>'


def urdf_with(tmp_path: Path, *parts: str) -> Urdf:
    return load_urdf(urdf_of(tmp_path, *parts))


def kinds(urdf: Urdf) -> dict[str, str]:
    return {each.name.removesuffix("_joint"): each.type for each in urdf.model.robot.joints}


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_joint_without_a_range_is_fixed_where_it_is(tmp_path: Path, kind: str) -> None:
    still = joint("a", "base", "0.1 0.2 0.3", "0 1 0", kind, BOTH.format(0.4))
    urdf = urdf_with(tmp_path, BASE, link("a"), still, link("b"), joint("b", "a"))
    found, notes = without_still(urdf)
    assert notes == ("a_joint is taken to be fixed, as the two limits are nearly the same",)
    assert kinds(found) == {"a": "fixed", "b": "revolute"}
    urdf.model.update_cfg({"a_joint": 0.4})
    for name in ("a", "b"):
        poses = [each.model.get_transform(name, "base") for each in (urdf, found)]
        np.testing.assert_allclose(poses[0], poses[1], atol=1e-6)
    assert without_still(found) == (found, ())


@pytest.mark.parametrize(("low", "high", "at"), [(0, 0.004, 0), (-0.004, 0, 0), (0.1, 0.104, 0.1)])
def test_a_lock_that_slides_by_some_millimetres_is_fixed(
    tmp_path: Path, low: float, high: float, at: float
) -> None:
    limit = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
    lock = joint("lock", "base", "0 0 0.1", "0 0 1", "prismatic", limit)
    urdf = urdf_with(tmp_path, BASE, link("lock"), lock, link("bit"), joint("bit", "lock"))
    found, _ = without_still(urdf)
    assert kinds(found)["lock"] == "fixed"
    assert found.model.get_transform("lock", "base")[2, 3] == pytest.approx(0.1 + at)


def test_joints_from_which_nothing_hangs_that_moves_or_that_others_follow_remain(
    tmp_path: Path,
) -> None:
    """A finger that is not used, and what the joints of a linkage follow."""
    follows = '<limit lower="0" upper="0" effort="1" velocity="1"/><mimic joint="b_joint"/>'
    none = BOTH.format(0)
    parts = (
        BASE, link("a"), joint("a", "base"), link("finger"), joint("finger", "a", more=none),
        link("tip"), joint("tip", "finger", more=none), link("b"), joint("b", "base", more=none),
        link("c"), joint("c", "b"), link("d"), joint("d", "base", more=follows),
    )  # fmt: skip
    urdf = urdf_with(tmp_path, *parts)
    assert without_still(urdf) == (urdf, ())


def test_a_joint_that_cannot_move_is_none_of_an_arm_and_is_told(tmp_path: Path) -> None:
    """Of four joints before a gripper, one is there for a tool that was left out."""
    arm = chain("arm", 3, "base", first="0 0 0.6")
    mount = link("mount") + joint("mount", "arm2", more=BOTH.format(0))
    urdf = urdf_of(tmp_path, BASE, arm, mount, fingers("jaw", "mount"))
    with pytest.raises(RobotError) as caught:
        make_robot_folder(urdf, tmp_path / "mine")
    assert "3 joints from 'arm0_joint' to 'arm2_joint' (too few joints)); mount_joint is" in str(
        caught.value
    )
    more = chain("arm", 5, "base", first="0 0 0.6")
    mount = mount.replace("arm2", "arm4")
    urdf = urdf_of(tmp_path, BASE, more, mount, fingers("jaw", "mount"))
    found, changes = without_still(load_urdf(urdf))
    proposal = propose(found, Wishes(), changes=changes)
    (own,) = proposal.words.arms
    between = proposal.urdf.joints_between(own.base_link, own.tool_frame)
    moving = [each.name for each in between if each.type in MOVING]
    assert moving == [f"arm{i}_joint" for i in range(5)]
    said = "mount_joint is taken to be fixed, as the two limits are nearly the same"
    assert said in proposal.notes
