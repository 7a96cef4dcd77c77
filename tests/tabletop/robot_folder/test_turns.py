"""Which way round a tool frame is added: as the last joint of the arm can turn it up."""

import numpy as np
import pytest
from small_urdfs import box, fingers, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose
from cgtorch.tabletop.robot_folder.structure import Structure
from cgtorch.tabletop.robot_folder.turns import OVER, upright

WAYS = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "1 0 0")


def arm(tmp_path, ends="-2.6 2.6", follow=False):
    """An arm of five joints that points to x at rest, and of which the last one rolls."""
    parts, above = [link("base", box("0.2 0.2 0.6", "0 0 0.3"))], "base"
    for i, axis in enumerate(WAYS):
        low, high = ("-1.5 1.5" if i < 4 else ends).split()
        limit = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
        limit += '<mimic joint="a2_joint" multiplier="-1"/>' if follow and i == 3 else ""
        at = "0 0 0.7" if not i else "0.2 0 0"
        parts += [link(f"a{i}", box()), joint(f"a{i}", above, at, axis, more=limit)]
        above = f"a{i}"
    return load_urdf(urdf_of(tmp_path, *parts, fingers("f", above, "0.05 {} 0")))


def turned(tmp_path, pose, **options):
    urdf = arm(tmp_path, **options)
    chain = Structure(urdf, "base").path("a4")
    return upright(Structure(urdf, "base"), chain, "a4", pose)


@pytest.mark.parametrize("follow", [False, True])
def test_what_can_only_be_held_upside_down_is_turned_about_its_approach(tmp_path, follow):
    np.testing.assert_array_equal(turned(tmp_path, OVER, follow=follow), np.eye(4))
    np.testing.assert_array_equal(turned(tmp_path, np.eye(4), follow=follow), np.eye(4))


def test_where_the_joint_turns_all_round_the_frame_stays(tmp_path):
    for pose in (np.eye(4), OVER):
        np.testing.assert_array_equal(turned(tmp_path, pose, ends="-6.2 6.2"), pose)


@pytest.mark.parametrize(("ends", "z"), [("-2.6 2.6", 1.0), ("0.6 5.6", -1.0)])
def test_an_added_frame_is_up_in_the_middle_of_the_joints_range(tmp_path, ends, z):
    found = propose(arm(tmp_path, ends), Wishes())
    assert found.words.arms[0].tool_frame == "arm_tool_frame"
    pose = found.urdf.model.get_transform("arm_tool_frame", "a4")
    np.testing.assert_allclose(pose[:3, 0], [1, 0, 0], atol=1e-9)
    assert pose[2, 2] == pytest.approx(z)
