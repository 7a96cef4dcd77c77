import math

import pytest
import torch
from support import tool_pose


def test_tool_frames_agree_with_yourdfpy(robot_and_arm, random_joints, generator):
    robot, arm = robot_and_arm
    q = random_joints(arm, 200, generator)
    pose = tool_pose(arm, q)
    model, words = robot.urdf.model, robot.description
    (tool,) = (a.tool_frame for a in words.arms if a.name == arm.name)
    for angles, got in zip(q, pose, strict=True):
        torso = {words.torso_joint: words.torso_position}
        model.update_cfg(dict(zip(arm.joint_names, angles.tolist(), strict=True)) | torso)
        want = torch.tensor(model.get_transform(tool, words.base_frame))
        assert (got[:3, 3] - want[:3, 3]).norm() < 1e-6
        assert (got[:3, :3] - want[:3, :3]).abs().max() < 1e-6


def test_any_leading_shape_and_dtype(pr2, random_joints, generator):
    arm = pr2.arms[0]
    q = random_joints(arm, 24, generator)
    flat = tool_pose(arm, q)
    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 1e-5)):
        shaped = tool_pose(arm, q.reshape(2, 3, 4, 7).to(dtype))
        assert shaped.dtype == dtype
        assert shaped.shape == (2, 3, 4, 4, 4)
        torch.testing.assert_close(shaped.reshape(24, 4, 4).double(), flat, atol=tolerance, rtol=0)
    assert tool_pose(arm, q[0]).shape == (4, 4)
    assert tool_pose(arm, q[:0]).shape == (0, 4, 4)


def test_large_batches_are_cut_without_a_seam(pr2, random_joints, generator):
    q = random_joints(pr2.arms[1], 20_000, generator).float()
    whole = tool_pose(pr2.arms[1], q)
    torch.testing.assert_close(whole[16_380:16_390], tool_pose(pr2.arms[1], q[16_380:16_390]))


def test_continuous_joints_get_finite_limits_on_the_chain(pr2):
    for arm in pr2.arms:
        low, high = arm.chain(torch.zeros(1))[0].get_joint_limits()
        for i, continuous in enumerate(arm.continuous.tolist()):
            assert math.isfinite(low[i])
            assert low[i] < high[i]
            if continuous:
                assert high[i] == pytest.approx(3 * math.pi)


def test_soft_limits_are_kept(pr2):
    arm = pr2.arms[0]
    assert arm.lower[3] == pytest.approx(-2.1213)
    assert arm.upper[3] == pytest.approx(-0.15)


def test_no_posture_reaches_further_than_the_arm_is_long(pr2, random_joints, generator):
    for arm in pr2.arms:
        tool = tool_pose(arm, random_joints(arm, 20_000, generator))[:, :3, 3]
        away = (tool - arm.mount[:3, 3]).norm(dim=1)
        assert (away <= arm.reach).all()
        assert away.max() > 0.9 * arm.reach
