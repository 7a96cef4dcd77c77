"""The Fetch's URDF says what the robot's public description says."""

import numpy as np
import pytest
import torch
from support import tool_pose

from cgtorch.tabletop.kinematics.grasping import waypoints

X, Y, Z, RIGHT = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0)
FACTS = [
    ("torso_fixed_joint", "fixed", "base_link", "torso_fixed_link", (-0.086875, 0, 0.377425),
     None, None),
    ("torso_lift_joint", "prismatic", "base_link", "torso_lift_link", (-0.086875, 0, 0.37743), Z,
     (0, 0.38615)),
    ("bellows_joint", "fixed", "torso_lift_link", "bellows_link", (0, 0, 0), None, None),
    ("head_pan_joint", "revolute", "torso_lift_link", "head_pan_link",
     (0.053125, 0, 0.603001417713939), Z, (-1.57, 1.57)),
    ("head_tilt_joint", "revolute", "head_pan_link", "head_tilt_link", (0.14253, 0, 0.057999), Y,
     (-0.76, 1.45)),
    ("head_camera_joint", "fixed", "head_tilt_link", "head_camera_link", (0.055, 0, 0.0225),
     None, None),
    ("shoulder_pan_joint", "revolute", "torso_lift_link", "shoulder_pan_link",
     (0.119525, 0, 0.34858), Z, (-1.6056, 1.6056)),
    ("shoulder_lift_joint", "revolute", "shoulder_pan_link", "shoulder_lift_link",
     (0.117, 0, 0.06), Y, (-1.221, 1.518)),
    ("upperarm_roll_joint", "continuous", "shoulder_lift_link", "upperarm_roll_link",
     (0.219, 0, 0), X, None),
    ("elbow_flex_joint", "revolute", "upperarm_roll_link", "elbow_flex_link", (0.133, 0, 0), Y,
     (-2.251, 2.251)),
    ("forearm_roll_joint", "continuous", "elbow_flex_link", "forearm_roll_link", (0.197, 0, 0), X,
     None),
    ("wrist_flex_joint", "revolute", "forearm_roll_link", "wrist_flex_link", (0.1245, 0, 0), Y,
     (-2.16, 2.16)),
    ("wrist_roll_joint", "continuous", "wrist_flex_link", "wrist_roll_link", (0.1385, 0, 0), X,
     None),
    ("gripper_axis", "fixed", "wrist_roll_link", "gripper_link", (0.16645, 0, 0), None, None),
    ("r_gripper_finger_joint", "prismatic", "gripper_link", "r_gripper_finger_link",
     (0, 0.015425, 0), Y, (0, 0.05)),
    ("l_gripper_finger_joint", "prismatic", "gripper_link", "l_gripper_finger_link",
     (0, -0.015425, 0), RIGHT, (0, 0.05)),
]  # fmt: skip


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: fact[0])
def test_joint(fetch, fact):
    name, kind, parent, child, xyz, axis, limits = fact
    joint = fetch.urdf.model.joint_map[name]
    assert (joint.type, joint.parent, joint.child) == (kind, parent, child)
    np.testing.assert_allclose(joint.origin[:3, 3], xyz, atol=1e-6)
    np.testing.assert_allclose(joint.origin[:3, :3], np.eye(3), atol=1e-12)
    if axis is not None:
        np.testing.assert_array_equal(joint.axis, axis)
        assert joint.limit.effort > 0
        assert joint.limit.velocity > 0
    if limits is None:
        assert joint.limit is None or joint.limit.lower is None
    else:
        np.testing.assert_allclose((joint.limit.lower, joint.limit.upper), limits, atol=1e-9)


def test_there_are_no_other_joints(fetch):
    assert set(fetch.urdf.model.joint_map) == {fact[0] for fact in FACTS}


def test_every_link_with_a_body_has_shapes_of_primitives_and_a_sound_inertia(fetch):
    colours = set(fetch.urdf.model._material_map)
    for link in fetch.urdf.model.robot.links:
        if link.name == "head_camera_link":
            continue
        shapes = [*link.visuals, *link.collisions]
        assert len(shapes) >= 2, link.name
        assert all(shape.geometry.box is not None for shape in shapes)
        assert all(visual.material.name in colours for visual in link.visuals)
        assert link.inertial.mass > 0, link.name
        moments = np.linalg.eigvalsh(link.inertial.inertia)
        assert moments[0] > 0, link.name
        assert moments[2] <= moments[0] + moments[1] + 1e-9, link.name


def bounds(link):
    """(2, 3) least and greatest coordinates of a link's collision boxes in its frame."""
    ends = [
        shape.origin[:3, 3] + sign * shape.geometry.box.size / 2
        for shape in link.collisions
        for sign in (-1, 1)
    ]
    return np.min(ends, axis=0), np.max(ends, axis=0)


SIZES = {
    "base_link": ((-0.2869, -0.2641, 0), (0.2864, 0.2641, 0.3589)),
    "torso_lift_link": ((-0.1852, -0.1708, 0.0285), (0.1716, 0.1708, 0.603)),
    "torso_fixed_link": ((-0.1683, -0.1554, -0.0186), (-0.0321, 0.1554, 0.4433)),
    "bellows_link": ((-0.0332, -0.1494, -0.2983), (0.0431, 0.1494, 0.0285)),
    "head_pan_link": ((-0.1249, -0.143, -0.003), (0.1975, 0.143, 0.113)),
    "head_tilt_link": ((-0.055, -0.105, -0.055), (0.055, 0.105, 0.055)),
    "shoulder_pan_link": ((-0.052, -0.0745, -0.048), (0.1775, 0.052, 0.1205)),
    "shoulder_lift_link": ((-0.06, -0.052, -0.0597), (0.172, 0.0705, 0.0597)),
    "upperarm_roll_link": ((-0.048, -0.0705, -0.052), (0.185, 0.052, 0.052)),
    "elbow_flex_link": ((-0.052, -0.052, -0.052), (0.166, 0.0705, 0.052)),
    "forearm_roll_link": ((-0.032, -0.087, -0.052), (0.1765, 0.052, 0.052)),
    "wrist_flex_link": ((-0.052, -0.054, -0.052), (0.1165, 0.067, 0.052)),
    "wrist_roll_link": ((-0.023, -0.0519, -0.052), (0.0195, 0.0519, 0.052)),
    "gripper_link": ((-0.154, -0.063, -0.0399), (-0.032, 0.063, 0.0396)),
    "r_gripper_finger_link": ((-0.029, -0.0158, -0.0132), (0.031, -0.0014, 0.0132)),
    "l_gripper_finger_link": ((-0.029, 0.0014, -0.0132), (0.031, 0.0158, 0.0132)),
}
"""Published overall sizes of the links, each in its own frame, m."""


@pytest.mark.parametrize("name", SIZES)
def test_overall_size(fetch, name):
    np.testing.assert_allclose(bounds(fetch.urdf.link(name)), SIZES[name], atol=0.004)


def test_the_footprint_bounds_all_that_stands_still(fetch):
    x_min, x_max, y_min, y_max = fetch.description.footprint
    body = fetch.body
    assert torch.equal(body.rotation, torch.eye(3, dtype=torch.float64).expand_as(body.rotation))
    low, high = (body.centre - body.half).amin(0), (body.centre + body.half).amax(0)
    torch.testing.assert_close(low[:2], torch.tensor([x_min, y_min], dtype=torch.float64))
    torch.testing.assert_close(high[:2], torch.tensor([x_max, y_max], dtype=torch.float64))


def test_the_whole_arm_is_drawn_out_straight(fetch):
    """0.6735 m from the shoulder's lift axis to the wrist and 0.30495 m on to the finger tips."""
    (arm,) = fetch.arms
    tool = tool_pose(fetch.arms[0], torch.zeros(7, dtype=torch.float64))[:3, 3]
    shoulder = [-0.086875 + 0.119525 + 0.117, 0, 0.37743 + 0.3 + 0.34858 + 0.06]
    expected = torch.tensor(shoulder, dtype=torch.float64)
    expected[0] += 0.6735 + 0.30495
    torch.testing.assert_close(tool, expected, atol=1e-6, rtol=0)
    assert fetch.description.torso_position == 0.3
    assert arm.closed_form is not None
    assert len(arm.closed_form.branches) == 8


@pytest.mark.parametrize("steepness", [0.0, 0.785, 1.57])
def test_the_tool_reaches_over_the_edge_of_a_table(fetch, steepness):
    objects = torch.tensor([[0.7, 0.0, 0.74], [0.6, 0.2, 0.74], [0.6, -0.2, 0.74]])
    row, _ = fetch.arms[0].candidates(waypoints(objects, steepness, 0.0)[:, 2])
    assert set(row.tolist()) == {0, 1, 2}
