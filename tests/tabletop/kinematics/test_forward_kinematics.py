import math

import pytest
import torch

from cgtorch.ground.errors import RobotError


def test_tool_frames_agree_with_yourdfpy(robot_and_arm, random_joints, generator):
    robot, arm = robot_and_arm
    q = random_joints(arm, 1000, generator)
    pose = robot.forward_kinematics(arm.name, q)
    model, words = robot.urdf.model, robot.description
    (tool,) = (a.tool_frame for a in words.arms if a.name == arm.name)
    for angles, got in zip(q, pose, strict=True):
        torso = {words.torso_joint: words.torso_position}
        model.update_cfg(dict(zip(arm.joint_names, angles.tolist(), strict=True)) | torso)
        want = torch.tensor(model.get_transform(tool, words.base_frame))
        assert (got[:3, 3] - want[:3, 3]).norm() < 1e-6
        assert (got[:3, :3] - want[:3, :3]).abs().max() < 1e-6


def test_any_leading_shape_and_dtype(pr2, random_joints, generator):
    q = random_joints(pr2.arm("left"), 24, generator)
    flat = pr2.forward_kinematics("left", q)
    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 1e-5)):
        shaped = pr2.forward_kinematics("left", q.reshape(2, 3, 4, 7).to(dtype))
        assert shaped.dtype == dtype
        assert shaped.shape == (2, 3, 4, 4, 4)
        torch.testing.assert_close(shaped.reshape(24, 4, 4).double(), flat, atol=tolerance, rtol=0)
    assert pr2.forward_kinematics("left", q[0]).shape == (4, 4)
    assert pr2.forward_kinematics("left", q[:0]).shape == (0, 4, 4)


def test_large_batches_are_cut_without_a_seam(pr2, random_joints, generator):
    q = random_joints(pr2.arm("right"), 20_000, generator).float()
    whole = pr2.forward_kinematics("right", q)
    torch.testing.assert_close(
        whole[16_380:16_390], pr2.forward_kinematics("right", q[16_380:16_390])
    )


def test_continuous_joints_get_finite_limits_on_the_chain(pr2):
    for arm in pr2.arms:
        low, high = arm.chain(torch.zeros(1)).get_joint_limits()
        for i, continuous in enumerate(arm.continuous.tolist()):
            assert math.isfinite(low[i])
            assert low[i] < high[i]
            if continuous:
                assert high[i] == pytest.approx(3 * math.pi)


def test_soft_limits_are_kept(pr2):
    arm = pr2.arm("left")
    assert arm.lower[3] == pytest.approx(-2.1213)
    assert arm.upper[3] == pytest.approx(-0.15)


def test_unknown_arm_and_wrong_joint_count(pr2):
    with pytest.raises(RobotError, match="no arm 'third': its arms are left, right"):
        pr2.forward_kinematics("third", torch.zeros(1, 7))
    with pytest.raises(RobotError, match=r"shape \(1, 6\).*takes \(\.\.\., 7\)"):
        pr2.forward_kinematics("left", torch.zeros(1, 6))


def test_no_posture_reaches_further_than_the_arm_is_long(pr2, random_joints, generator):
    for arm in pr2.arms:
        tool = pr2.forward_kinematics(arm.name, random_joints(arm, 20_000, generator))[:, :3, 3]
        away = (tool - arm.mount[:3, 3]).norm(dim=1)
        assert (away <= arm.reach).all()
        assert away.max() > 0.9 * arm.reach
