"""Tools without fingers that point another way than the last joint of their arm, or lie beside."""

import math

import numpy as np
import pytest
from small_urdfs import box, chain, joint, link, urdf_of

from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.robot_folder.proposal import Wishes, propose

ARM = link("base", box("0.2 0.2 0.5", "0 0 0.25")) + chain("arm", 5, "base", first="0 0 0.5")
PLATE = link("plate", box("0.14 0.06 0.01", "-0.05 0 0.005")) + joint("plate", "arm4", "0 0 0.1")
CUP = link("vacuum", box("0.02 0.02 0.04", "0 0 0.02"))
TURNED = f'<origin xyz="0.1 0 0.3" rpy="0 {math.pi / 4} 0"/>'


def fixed(name, above, at):
    return joint(name, above, at, kind="fixed", more="")


def tool_in(tmp_path, *parts):
    found = propose(load_urdf(urdf_of(tmp_path, ARM, PLATE, *parts)), Wishes())
    pose = found.urdf.model.get_transform(found.words.arms[0].tool_frame, "plate")
    return pose, "\n".join(found.notes)


@pytest.mark.parametrize("frame", [True, False])
def test_a_sucker_beside_the_axis_is_approached_as_it_points(tmp_path, frame):
    tcp = link("tcp", "") + fixed("tcp", "vacuum", "0 0 0.04") if frame else ""
    pose, notes = tool_in(tmp_path, CUP + fixed("vacuum", "plate", "-0.09 0 0.01"), tcp)
    np.testing.assert_allclose(pose[:3, 0], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(pose[:3, 3], [-0.09, 0, 0.05 + 0.06], atol=1e-9)
    assert f"0.06 m beyond '{'tcp' if frame else 'vacuum'}', the way it points" in notes


def test_a_bent_torch_is_approached_along_its_wire(tmp_path):
    bent = box("0.02 0.02 0.2", "0 0 0.1") + box("0.02 0.02 0.02", "0.05 0 0.25")
    torch = link("torch", bent) + fixed("torch", "plate", "0 0 0")
    tip = link("wire_tip", "") + fixed("wire_tip", "torch", "0 0 0").replace(
        '<origin xyz="0 0 0"/>', TURNED
    )
    pose, _ = tool_in(tmp_path, torch, tip)
    way = np.array([1, 0, 1]) / math.sqrt(2)
    np.testing.assert_allclose(pose[:3, 0], way, atol=1e-9)
    np.testing.assert_allclose(pose[:3, 3], [0.1, 0, 0.3] + 0.06 * way, atol=1e-9)


def test_a_camera_beside_a_sucker_on_the_axis_is_no_tool(tmp_path):
    camera = link("camera", box(at="0.1 0 0")) + fixed("camera", "plate", "0.1 0 0")
    pose, _ = tool_in(tmp_path, CUP + fixed("vacuum", "plate", "0 0 0.01"), camera)
    np.testing.assert_allclose(pose[:3, 0], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(pose[:3, 3], [0, 0, 0.05 + 0.06], atol=1e-9)


@pytest.mark.parametrize(
    "parts",
    [
        [("one", "0 0 0")],  # within the plate
        [("left", "0.05 0 0.1"), ("right", "0 0 0.1")],
        [("tip_a", "0.05 0 0.1"), ("tip_b", "0 0 0.1")],
        [("side", "0.07 0.07 0.09")],  # along none of its axes
    ],
)
def test_an_end_that_is_not_known_is_none(tmp_path, parts):
    each = (link(name, "") + fixed(name, "plate", at) for name, at in parts)
    assert "beyond its end" in tool_in(tmp_path, *each)[1]
