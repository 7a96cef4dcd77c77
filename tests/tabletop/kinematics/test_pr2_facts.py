"""The PR2's URDF says what the robot's public description says."""

import math

import numpy as np
import pytest
import torch

from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT, waypoints

FIXED, LIFT = "fixed", "prismatic"
TURN, ROLL = "revolute", "continuous"


def arm_facts(s, sign):
    """Rows of an arm: joint, type, parent, child, xyz, axis, limits, soft limits."""
    pan = sorted([-0.7146018366 * sign, 2.2853981634 * sign])
    pan_soft = sorted([-0.5646018366 * sign, 2.1353981634 * sign])
    roll, roll_soft = sorted([-0.8 * sign, 3.9 * sign]), sorted([-0.65 * sign, 3.75 * sign])
    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    rows = [
        ("shoulder_pan_joint", TURN, None, "shoulder_pan", (0, 0.188 * sign, 0), z, pan, pan_soft),
        ("shoulder_lift_joint", TURN, "shoulder_pan", "shoulder_lift", (0.1, 0, 0), y,
         (-0.5236, 1.3963), (-0.3536, 1.2963)),
        ("upper_arm_roll_joint", TURN, "shoulder_lift", "upper_arm_roll", (0, 0, 0), x, roll,
         roll_soft),
        ("upper_arm_joint", FIXED, "upper_arm_roll", "upper_arm", (0, 0, 0), None, None, None),
        ("elbow_flex_joint", TURN, "upper_arm", "elbow_flex", (0.4, 0, 0), y, (-2.3213, 0),
         (-2.1213, -0.15)),
        ("forearm_roll_joint", ROLL, "elbow_flex", "forearm_roll", (0, 0, 0), x, None, None),
        ("forearm_joint", FIXED, "forearm_roll", "forearm", (0, 0, 0), None, None, None),
        ("wrist_flex_joint", TURN, "forearm", "wrist_flex", (0.321, 0, 0), y, (-2.18, 0),
         (-2.0, -0.1)),
        ("wrist_roll_joint", ROLL, "wrist_flex", "wrist_roll", (0, 0, 0), x, None, None),
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
    ("torso_lift_joint", LIFT, "base_link", "torso_lift_link", (-0.05, 0, 0.739675), (0, 0, 1),
     (0, 0.33), (0.0115, 0.325)),
    ("head_pan_joint", TURN, "torso_lift_link", "head_pan_link", (-0.01707, 0, 0.38145), (0, 0, 1),
     (-3.007, 3.007), (-2.857, 2.857)),
    ("head_tilt_joint", TURN, "head_pan_link", "head_tilt_link", (0.068, 0, 0), (0, 1, 0),
     (-0.471238, 1.39626), (-0.3712, 1.29626)),
    ("head_plate_frame_joint", FIXED, "head_tilt_link", "head_plate_frame", (0.0232, 0, 0.0645),
     None, None, None),
    ("wide_stereo_frame", FIXED, "head_plate_frame", "wide_stereo_link", (0.045, 0.03, 0.0501),
     None, None, None),
]  # fmt: skip
FACTS = [*BODY, *arm_facts("l", 1), *arm_facts("r", -1)]


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: fact[0])
def test_joint(pr2, fact):
    name, kind, parent, child, xyz, axis, limits, soft = fact
    joint = pr2.urdf.model.joint_map[name]
    assert (joint.type, joint.parent, joint.child) == (kind, parent, child)
    np.testing.assert_allclose(joint.origin[:3, 3], xyz, atol=1e-9)
    np.testing.assert_allclose(joint.origin[:3, :3], np.eye(3), atol=1e-12)
    if axis is not None:
        np.testing.assert_array_equal(joint.axis, axis)
        assert joint.limit.effort > 0
        assert joint.limit.velocity > 0
    if limits is None:
        assert joint.limit is None or joint.limit.lower is None
    else:
        np.testing.assert_allclose((joint.limit.lower, joint.limit.upper), limits, atol=1e-9)
    if soft is None:
        assert joint.safety_controller is None
    else:
        controller = joint.safety_controller
        kept = (controller.soft_lower_limit, controller.soft_upper_limit)
        np.testing.assert_allclose(kept, soft, atol=1e-9)


def test_there_are_no_other_joints(pr2):
    assert set(pr2.urdf.model.joint_map) == {fact[0] for fact in FACTS}


@pytest.mark.parametrize("side", ["l", "r"])
def test_right_finger_and_both_tips_follow_the_left_finger(pr2, side):
    leader = f"{side}_gripper_l_finger_joint"
    assert pr2.urdf.model.joint_map[leader].mimic is None
    for follower in ("l_finger_tip", "r_finger", "r_finger_tip"):
        mimic = pr2.urdf.model.joint_map[f"{side}_gripper_{follower}_joint"].mimic
        assert (mimic.joint, mimic.multiplier, mimic.offset) == (leader, 1.0, 0.0)


def test_every_link_with_a_body_has_shapes_of_primitives_and_a_sound_inertia(pr2):
    empty = {"base_footprint", "l_gripper_tool_frame", "r_gripper_tool_frame"}
    colours = set(pr2.urdf.model._material_map)
    for link in pr2.urdf.model.robot.links:
        if link.name in empty:
            continue
        assert link.visuals, link.name
        assert link.collisions, link.name
        assert all(shape.geometry.mesh is None for shape in [*link.visuals, *link.collisions])
        assert all(visual.material.name in colours for visual in link.visuals)
        assert link.inertial.mass > 0, link.name
        moments = np.linalg.eigvalsh(link.inertial.inertia)
        assert moments[0] > 0, link.name
        assert moments[2] <= moments[0] + moments[1] + 1e-9, link.name


def test_sizes(pr2):
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
