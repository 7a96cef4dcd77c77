"""The URDFs of the built-in robots say what the robots' public descriptions say."""

import math

import numpy as np
import pytest
import torch
from support import tool_pose

from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT, waypoints

FIXED, SLIDE, TURN, ROLL = "fixed", "prismatic", "revolute", "continuous"
X, Y, Z, RIGHT = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0)


def arm_facts(s, sign):
    """Rows of an arm: joint, type, parent, child, xyz, axis, limits, soft limits."""
    pan = sorted([-0.7146018366 * sign, 2.2853981634 * sign])
    pan_soft = sorted([-0.5646018366 * sign, 2.1353981634 * sign])
    roll, roll_soft = sorted([-0.8 * sign, 3.9 * sign]), sorted([-0.65 * sign, 3.75 * sign])
    rows = [
        ("shoulder_pan_joint", TURN, None, "shoulder_pan", (0, 0.188 * sign, 0), Z, pan, pan_soft),
        ("shoulder_lift_joint", TURN, "shoulder_pan", "shoulder_lift", (0.1, 0, 0), Y,
         (-0.5236, 1.3963), (-0.3536, 1.2963)),
        ("upper_arm_roll_joint", TURN, "shoulder_lift", "upper_arm_roll", (0, 0, 0), X, roll,
         roll_soft),
        ("upper_arm_joint", FIXED, "upper_arm_roll", "upper_arm", (0, 0, 0), None, None, None),
        ("elbow_flex_joint", TURN, "upper_arm", "elbow_flex", (0.4, 0, 0), Y, (-2.3213, 0),
         (-2.1213, -0.15)),
        ("forearm_roll_joint", ROLL, "elbow_flex", "forearm_roll", (0, 0, 0), X, None, None),
        ("forearm_joint", FIXED, "forearm_roll", "forearm", (0, 0, 0), None, None, None),
        ("wrist_flex_joint", TURN, "forearm", "wrist_flex", (0.321, 0, 0), Y, (-2.18, 0),
         (-2.0, -0.1)),
        ("wrist_roll_joint", ROLL, "wrist_flex", "wrist_roll", (0, 0, 0), X, None, None),
        ("gripper_palm_joint", FIXED, "wrist_roll", "gripper_palm", (0, 0, 0), None, None, None),
        ("gripper_tool_joint", FIXED, "gripper_palm", "gripper_tool_frame", (0.18, 0, 0), None,
         None, None),
    ]  # fmt: skip
    for f, side in (("l", 1), ("r", -1)):
        finger, tip = f"gripper_{f}_finger", f"gripper_{f}_finger_tip"
        rows += [
            (f"{finger}_joint", TURN, "gripper_palm", finger, (0.07691, 0.01 * side, 0),
             (0, 0, side), (0, 0.548), None),
            (f"{tip}_joint", TURN, finger, tip, (0.09137, 0.00495 * side, 0), (0, 0, -side),
             (0, 0.548), None),
        ]  # fmt: skip
    for joint, kind, parent, child, *rest in rows:
        tail = "" if child == "gripper_tool_frame" else "_link"
        above = "torso_lift_link" if parent is None else f"{s}_{parent}_link"
        yield (f"{s}_{joint}", kind, above, f"{s}_{child}{tail}", *rest)


BODY = [
    ("base_footprint_joint", FIXED, "base_footprint", "base_link", (0, 0, 0.051), None, None, None),
    ("torso_lift_joint", SLIDE, "base_link", "torso_lift_link", (-0.05, 0, 0.739675), Z,
     (0, 0.33), (0.0115, 0.325)),
    ("head_pan_joint", TURN, "torso_lift_link", "head_pan_link", (-0.01707, 0, 0.38145), Z,
     (-3.007, 3.007), (-2.857, 2.857)),
    ("head_tilt_joint", TURN, "head_pan_link", "head_tilt_link", (0.068, 0, 0), Y,
     (-0.471238, 1.39626), (-0.3712, 1.29626)),
    ("head_plate_frame_joint", FIXED, "head_tilt_link", "head_plate_frame", (0.0232, 0, 0.0645),
     None, None, None),
    ("wide_stereo_frame", FIXED, "head_plate_frame", "wide_stereo_link", (0.045, 0.03, 0.0501),
     None, None, None),
]  # fmt: skip
PR2 = [*BODY, *arm_facts("l", 1), *arm_facts("r", -1)]
FETCH = [
    ("torso_fixed_joint", FIXED, "base_link", "torso_fixed_link", (-0.086875, 0, 0.377425),
     None, None),
    ("torso_lift_joint", SLIDE, "base_link", "torso_lift_link", (-0.086875, 0, 0.37743), Z,
     (0, 0.38615)),
    ("bellows_joint", FIXED, "torso_lift_link", "bellows_link", (0, 0, 0), None, None),
    ("head_pan_joint", TURN, "torso_lift_link", "head_pan_link",
     (0.053125, 0, 0.603001417713939), Z, (-1.57, 1.57)),
    ("head_tilt_joint", TURN, "head_pan_link", "head_tilt_link", (0.14253, 0, 0.057999), Y,
     (-0.76, 1.45)),
    ("head_camera_joint", FIXED, "head_tilt_link", "head_camera_link", (0.055, 0, 0.0225),
     None, None),
    ("shoulder_pan_joint", TURN, "torso_lift_link", "shoulder_pan_link",
     (0.119525, 0, 0.34858), Z, (-1.6056, 1.6056)),
    ("shoulder_lift_joint", TURN, "shoulder_pan_link", "shoulder_lift_link",
     (0.117, 0, 0.06), Y, (-1.221, 1.518)),
    ("upperarm_roll_joint", ROLL, "shoulder_lift_link", "upperarm_roll_link",
     (0.219, 0, 0), X, None),
    ("elbow_flex_joint", TURN, "upperarm_roll_link", "elbow_flex_link", (0.133, 0, 0), Y,
     (-2.251, 2.251)),
    ("forearm_roll_joint", ROLL, "elbow_flex_link", "forearm_roll_link", (0.197, 0, 0), X,
     None),
    ("wrist_flex_joint", TURN, "forearm_roll_link", "wrist_flex_link", (0.1245, 0, 0), Y,
     (-2.16, 2.16)),
    ("wrist_roll_joint", ROLL, "wrist_flex_link", "wrist_roll_link", (0.1385, 0, 0), X,
     None),
    ("gripper_axis", FIXED, "wrist_roll_link", "gripper_link", (0.16645, 0, 0), None, None),
    ("r_gripper_finger_joint", SLIDE, "gripper_link", "r_gripper_finger_link",
     (0, 0.015425, 0), Y, (0, 0.05)),
    ("l_gripper_finger_joint", SLIDE, "gripper_link", "l_gripper_finger_link",
     (0, -0.015425, 0), RIGHT, (0, 0.05)),
]  # fmt: skip
FACTS = [("pr2", *fact) for fact in PR2] + [("fetch", *fact, None) for fact in FETCH]


def is_within(limits, values):
    np.testing.assert_allclose(limits, values, atol=1e-9)


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: fact[1])
def test_joint(request, fact):
    robot, name, kind, parent, child, xyz, axis, limits, soft = fact
    joint = request.getfixturevalue(robot).urdf.model.joint_map[name]
    assert (joint.type, joint.parent, joint.child) == (kind, parent, child)
    np.testing.assert_allclose(joint.origin[:3, 3], xyz, atol=1e-9 if robot == "pr2" else 1e-6)
    np.testing.assert_allclose(joint.origin[:3, :3], np.eye(3), atol=1e-12)
    if axis is not None:
        np.testing.assert_array_equal(joint.axis, axis)
        assert joint.limit.effort > 0
        assert joint.limit.velocity > 0
    if limits is None:
        assert joint.limit is None or joint.limit.lower is None
    else:
        is_within((joint.limit.lower, joint.limit.upper), limits)
    if soft is None:
        assert joint.safety_controller is None
    else:
        controller = joint.safety_controller
        is_within((controller.soft_lower_limit, controller.soft_upper_limit), soft)


def test_there_are_no_other_joints(pr2, fetch):
    assert set(pr2.urdf.model.joint_map) == {fact[0] for fact in PR2}
    assert set(fetch.urdf.model.joint_map) == {fact[0] for fact in FETCH}


EMPTY = {"base_footprint", "l_gripper_tool_frame", "r_gripper_tool_frame", "head_camera_link"}


@pytest.mark.parametrize("name", ["pr2", "fetch"])
def test_every_link_with_a_body_has_shapes_of_primitives_and_a_sound_inertia(request, name):
    model = request.getfixturevalue(name).urdf.model
    for link in model.robot.links:
        if link.name in EMPTY:
            continue
        assert link.visuals, link.name
        assert link.collisions, link.name
        assert all(shape.geometry.mesh is None for shape in [*link.visuals, *link.collisions])
        assert all(visual.material.name in model._material_map for visual in link.visuals)
        assert link.inertial.mass > 0, link.name
        moments = np.linalg.eigvalsh(link.inertial.inertia)
        assert moments[0] > 0, link.name
        assert moments[2] <= moments[0] + moments[1] + 1e-9, link.name


@pytest.mark.parametrize("side", ["l", "r"])
def test_right_finger_and_both_tips_follow_the_left_finger(pr2, side):
    leader = f"{side}_gripper_l_finger_joint"
    assert pr2.urdf.model.joint_map[leader].mimic is None
    for follower in ("l_finger_tip", "r_finger", "r_finger_tip"):
        mimic = pr2.urdf.model.joint_map[f"{side}_gripper_{follower}_joint"].mimic
        assert (mimic.joint, mimic.multiplier, mimic.offset) == (leader, 1.0, 0.0)


def test_sizes_of_the_pr2(pr2):
    boxes = {
        link: pr2.urdf.model.link_map[link].collisions[0]
        for link in ("base_link", "torso_lift_link")
    }
    np.testing.assert_allclose(boxes["base_link"].geometry.box.size[:2], (0.668, 0.668))
    torso = boxes["torso_lift_link"]
    half = torso.geometry.box.size / 2
    np.testing.assert_allclose(torso.origin[:3, 3] - half, (-0.288, -0.264, -0.506), atol=1e-9)
    np.testing.assert_allclose(torso.origin[:3, 3] + half, (0.112, 0.264, 0.316), atol=1e-9)
    base = boxes["base_link"]
    top = base.origin[2, 3] + base.geometry.box.size[2] / 2 + 0.051
    assert top == pytest.approx(0.345)


def test_shoulder_height_follows_the_torso(pr2):
    for arm in pr2.arms:
        torso = pr2.description.torso_position
        assert arm.mount[2, 3] == pytest.approx(0.790675 + torso)
        assert torch.equal(arm.mount[:3, :3], torch.eye(3, dtype=torch.float64))


@pytest.mark.parametrize(("steepness", "reach"), [(90, 0.74), (45, 0.87), (0, 0.90)])
def test_furthest_forward_reach(pr2, steepness, reach):
    """With the torso at 0.15 m and the tool 0.75 m above the floor, straight ahead."""
    assert pr2.description.torso_position == 0.15
    x = torch.arange(0.4, 1.1, 0.005)
    objects = torch.stack([x, 0 * x, 0 * x + 0.75 - GRASP_HEIGHT], dim=1)
    pose = waypoints(objects, math.radians(steepness), 0.0)[:, 2]
    furthest = max(x[arm.candidates(pose)[0]].max().item() for arm in pr2.arms)
    assert furthest == pytest.approx(reach, abs=0.01)


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
    turn, centre, half = body.pose[..., :3], body.pose[..., 3], body.size[:, :3]
    assert torch.equal(turn, torch.eye(3, dtype=torch.float64).expand_as(turn))
    low, high = (centre - half).amin(0), (centre + half).amax(0)
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
