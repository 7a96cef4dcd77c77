import math

import pytest
import pytorch_kinematics
import torch
from support import tool_pose

from cgtorch.tabletop.kinematics.inverse_kinematics import NumericalArm, numerical_candidates


def reached(arm, pose, **keywords):
    """(B,) whether an arm has any solution."""
    found = torch.zeros(len(pose), dtype=torch.bool)
    found[arm.candidates(pose, **keywords)[0]] = True
    return found


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-6), (torch.float32, 2e-5)])
def test_every_solution_gives_the_pose_and_keeps_the_limits(
    robot_and_arm, random_joints, generator, dtype, tolerance
):
    _, arm = robot_and_arm
    pose = tool_pose(arm, random_joints(arm, 800, generator)).to(dtype)
    row, q = arm.candidates(pose)
    assert q.dtype == dtype
    error = (tool_pose(arm, q) - pose[row]).abs().amax()
    assert error < tolerance
    assert bool((q >= arm.lower.to(dtype) - 1e-5).all() and (q <= arm.upper.to(dtype) + 1e-5).all())
    assert bool((row[1:] >= row[:-1]).all())


def test_nearly_every_reachable_pose_is_found(robot_and_arm, random_joints, generator):
    _, arm = robot_and_arm
    pose = tool_pose(arm, random_joints(arm, 1500, generator))
    assert reached(arm, pose).double().mean() >= 0.97
    assert reached(arm, pose, samples=144).double().mean() >= 0.99


def test_both_branches_are_used(pr2, random_joints, generator):
    arm = pr2.arms[0]
    pose = tool_pose(arm, random_joints(arm, 300, generator))
    _, q = arm.candidates(pose)
    assert 0.1 < (q[:, 2].cos() > 0).double().mean() < 0.9


def test_poses_out_of_reach_have_no_solution(pr2):
    pose = torch.eye(4).repeat(2, 1, 1)
    pose[0, :3, 3] = torch.tensor([1.5, 0.0, 0.9])
    pose[1, :3, 3] = torch.tensor([-0.6, 0.0, 0.9])
    row, q = pr2.arms[0].candidates(pose)
    assert len(row) == len(q) == 0
    assert len(pr2.arms[0].candidates(pose[:0])[0]) == 0


def test_following_a_short_way_keeps_the_posture(robot_and_arm, random_joints, generator):
    _, arm = robot_and_arm
    pose = tool_pose(arm, random_joints(arm, 500, generator))
    row, q = arm.candidates(pose)
    way = pose[row][:, None].repeat(1, 3, 1, 1)
    way[:, :, 2, 3] += torch.tensor([0.0, 0.01, 0.02], dtype=torch.float64)
    path, sound = arm.follow(q, way)
    assert bool(sound[:, 0].all())
    assert arm.difference(path[:, 0], q).abs().max() < 1e-6
    ok = sound.all(dim=1)
    assert ok.double().mean() > 0.8
    error = tool_pose(arm, path[ok]) - way[ok]
    assert error.abs().max() < 1e-6
    assert torch.equal(path[ok][..., 2].cos() > 0, (q[ok][:, None, 2].cos() > 0).expand(-1, 3))


def oracle(arm, pose, retries=20):
    """pytorch-kinematics' own inverse kinematics: solutions and whether each pose was reached."""
    chain = arm.chain(pose)[0]
    lower = torch.where(arm.continuous, -math.pi, arm.lower).to(pose)
    upper = torch.where(arm.continuous, math.pi, arm.upper).to(pose)
    starts = lower + (upper - lower) * torch.rand(
        retries, len(lower), generator=torch.Generator().manual_seed(1), dtype=torch.float64
    ).to(pose)
    solver = pytorch_kinematics.PseudoInverseIK(
        chain, retry_configs=starts, max_iterations=30, lr=1.0, clamp_to_limits=True,
        early_stopping_any_converged=True, early_stopping_no_improvement=None,
    )  # fmt: skip
    local = torch.linalg.inv(arm.mount.to(pose)) @ pose
    solution = solver.solve(pytorch_kinematics.Transform3d(matrix=local))
    inside = (solution.solutions >= lower - 1e-4 - 2 * math.pi * arm.continuous) & (
        solution.solutions <= upper + 1e-4 + 2 * math.pi * arm.continuous
    )
    return (solution.converged & inside.all(dim=-1)).any(dim=1)


def test_agrees_with_an_independent_solver(robot_and_arm, random_joints, generator):
    """Poses in front of the robot, about half of them within reach."""
    _, arm = robot_and_arm
    pose = tool_pose(arm, random_joints(arm, 150, generator))
    pose[:, :3, 3] += 0.25 * torch.randn(150, 3, generator=generator, dtype=torch.float64)
    pose = pose.float()
    ours, theirs = reached(arm, pose, samples=144), oracle(arm, pose)
    assert 0.2 < theirs.double().mean() < 0.9
    assert ours[theirs].double().mean() >= 0.97
    assert theirs[ours].double().mean() >= 0.95


def test_numerical_solver_agrees_with_the_closed_form(pr2, random_joints, generator):
    arm = pr2.arms[0]
    pose = tool_pose(arm, random_joints(arm, 200, generator))
    local = torch.linalg.inv(arm.mount) @ pose
    lower = torch.where(arm.continuous, -math.pi, arm.lower)
    upper = torch.where(arm.continuous, math.pi, arm.upper)
    row, q = numerical_candidates(NumericalArm(arm.chain(pose)[0], lower, upper), local)
    assert len(row.unique()) / 200 >= 0.9
    error = tool_pose(arm, q) - pose[row]
    assert error[:, :3, 3].norm(dim=1).max() < 2e-4
    assert error[:, :3, :3].abs().max() < 2e-3
    assert bool((q >= lower - 1e-9).all() and (q <= upper + 1e-9).all())
