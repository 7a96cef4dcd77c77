"""How fingers in a row and a thumb are opened, and which way the tool frame is turned between."""

import numpy as np
import pytest
from small_urdfs import box, chain, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose

BASE = link("base", box("0.2 0.2 0.5", "0 0 0.25")) + chain("arm", 5, "base", first="0 0 0.5")
PALM = link("palm", box("0.02 0.1 0.08", "0 0 0.04")) + joint("palm", "arm4")


def limit(low, high):
    return f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'


def finger(name, above, at, axis, ends, length=0.07):
    shape = box(f"0.01 0.012 {length}", f"0 0 {length / 2}")
    return link(name, shape) + joint(name, above, at, axis, more=limit(*ends))


def proposed(tmp_path, *parts):
    found = propose(load_urdf(urdf_of(tmp_path, BASE, PALM, *parts)), Wishes())
    tool = found.words.arms[0].tool_frame
    return found.words.gripper_joints, found.urdf.model.get_transform(tool, "palm")


def row(count=4, **more):
    return [
        finger(f"f{i}", "palm", f"0 {0.04 - 0.027 * i} 0.08", "0 1 0", (0, 1.5), **more)
        for i in range(count)
    ]


@pytest.mark.parametrize(("axis", "ends"), [("0 -1 0", (0, 1.2)), ("0 1 0", (-1.2, 0))])
def test_fingers_that_pass_the_thumb_are_not_open_there(tmp_path, axis, ends):
    thumb = link("base2", box("0.03 0.01 0.01", "0.02 0 0")) + joint(
        "base2", "palm", "0.03 0 0.03", more=limit(-0.3, 0.3)
    )
    tip = finger("thumb", "base2", "0.04 0 0", axis, ends, length=0.09)
    held, pose = proposed(tmp_path, *row(), thumb, tip)
    assert [held[f"f{i}_joint"] for i in range(4)] == [0] * 4
    assert held["thumb_joint"] == 0
    np.testing.assert_allclose(pose[:3, 0], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(pose[:3, 1], [1, 0, 0], atol=1e-9)  # from the fingers to the thumb
    assert 0.02 < pose[0, 3] < 0.05
    assert pose[2, 3] == pytest.approx(0.08 + 0.07 - 0.02)


def test_fingers_of_two_joints_close_along_the_way_in_which_their_tips_are_bent(tmp_path):
    ends = [finger(f"e{i}", f"f{i}", "0 0 0.04", "0 1 0", (0, 1.5), 0.03) for i in range(4)]
    thumb = finger("thumb", "palm", "0.06 0.02 0.06", "0 -1 0", (0, 0.8), 0.05)
    _, pose = proposed(tmp_path, *row(length=0.035), *ends, thumb)
    np.testing.assert_allclose(pose[:3, 1], [1, 0, 0], atol=1e-9)


def test_jaws_that_pass_each_other_are_not_open_there(tmp_path):
    left = finger("left", "palm", "0 0.03 0.08", "1 0 0", (0, 1.5), 0.1)
    right = finger("right", "palm", "0 -0.03 0.08", "-1 0 0", (0, 1.5), 0.1)
    held, pose = proposed(tmp_path, left, right)
    assert (held["left_joint"], held["right_joint"]) == (0, 0)
    np.testing.assert_allclose(np.abs(pose[:3, 1]), [0, 1, 0], atol=1e-9)


@pytest.mark.parametrize(("length", "back"), [(0.012, 0.006), (0.03, 0.015), (0.1, 0.02)])
def test_the_frame_of_short_fingers_is_between_them(tmp_path, length, back):
    shape = box(f"0.01 0.01 {length}", f"0 0 {length / 2}")
    two = [
        link(n, shape) + joint(n, "palm", f"0 {y} 0.08", a, "prismatic", limit(0, 0.02))
        for n, y, a in (("left", 0.01, "0 1 0"), ("right", -0.01, "0 -1 0"))
    ]
    held, pose = proposed(tmp_path, *two)
    assert (held["left_joint"], held["right_joint"]) == (0.02, 0.02)
    assert pose[2, 3] == pytest.approx(0.08 + length - back)
