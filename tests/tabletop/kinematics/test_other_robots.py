"""Robots that are not the PR2, written here."""

import json
import math

import pytest
import torch
from support import tool_pose

from cgtorch.tabletop.kinematics import graspable, load_robot

AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
WORDS = {
    "name": "boxer",
    "base_frame": "base",
    "footprint": [-0.25, 0.25, -0.25, 0.25],
    "torso_joint": None,
    "torso_position": None,
    "arms": [{"name": "arm", "base_link": "base", "tool_frame": "tool"}],
    "body": ["base"],
}


def write(tmp_path, joints, **changes):
    """A robot on a box from (axis or None for default, xyz, lower and upper or None) rows."""
    parts = [
        '<robot name="boxer"><link name="base"><collision><origin xyz="0 0 0.3"/><geometry>'
        '<box size="0.5 0.5 0.6"/></geometry></collision></link>'
    ]
    parent = "base"
    for i, (axis, xyz, limits) in enumerate(joints):
        turn = "" if axis is None else f'<axis xyz="{AXES[axis]}"/>'
        kind = "continuous" if limits is None else "revolute"
        ends = "" if limits is None else f'lower="{limits[0]}" upper="{limits[1]}" '
        parts.append(
            f'<link name="l{i}"><collision><origin xyz="0 0 0"/><geometry><sphere radius="0.05"/>'
            f'</geometry></collision></link><joint name="j{i}" type="{kind}">'
            f'<parent link="{parent}"/><child link="l{i}"/><origin xyz="{xyz}"/>{turn}'
            f'<limit {ends}effort="1" velocity="1"/></joint>'
        )
        parent = f"l{i}"
    parts.append(
        f'<link name="tool"/><joint name="t" type="fixed"><parent link="{parent}"/>'
        '<child link="tool"/><origin xyz="0.12 0 0"/></joint></robot>'
    )
    (tmp_path / "boxer.urdf").write_text("".join(parts))
    (tmp_path / "words.json").write_text(json.dumps({**WORDS, **changes}))
    return load_robot(urdf=tmp_path / "boxer.urdf", description=tmp_path / "words.json")


UPRIGHT = [
    ("z", "0.1 0 0.7", (-3, 3)),
    ("y", "0 0 0.1", (-2, 2)),
    ("z", "0 0 0.2", (-3, 3)),
    ("y", "0 0 0.2", (-2.4, 2.4)),
    ("z", "0 0 0.2", None),
    ("y", "0 0 0.2", (-2, 2)),
    ("x", "0.05 0 0.05", (-3, 3)),
]
"""Seven joints about z, y, z, y, z, y, x: no closed form."""

REACHER = [
    ("z", "0.12 0 0.75", (-1.6, 1.6)),
    ("y", "0.117 0 0.06", (-1.2, 1.5)),
    ("x", "0.219 0 0", None),
    ("y", "0.133 0 0", (-2.25, 2.25)),
    ("x", "0.197 0 0", None),
    ("y", "0.1245 0 0", (-2.16, 2.16)),
    ("x", "0.1385 0 0", None),
]
"""Seven joints in the closed form's order, with offsets and limits unlike the PR2's."""


def objects(count, seed=0):
    """Objects 0.05 to 0.25 m in from the near edge of a wide table before the robot."""
    generator = torch.Generator().manual_seed(seed)
    gap = 0.3 + 0.6 * torch.rand(count, generator=generator)
    side = torch.rand(count, generator=generator) - 0.5
    inset = 0.05 + 0.2 * torch.rand(count, generator=generator)
    one = torch.ones(count)
    table = torch.stack([gap + 0.4, 0 * one, 0 * one, 0.8 * one, 1.4 * one, 0.74 * one], dim=1)
    return torch.stack([gap + inset, side, 0.74 * one], dim=1), table


def test_the_numerical_fallback_serves_any_other_arm(tmp_path, generator, random_joints):
    robot = write(tmp_path, UPRIGHT)
    (arm,) = robot.arms
    assert arm.closed_form is None
    pose = tool_pose(arm, random_joints(arm, 100, generator))
    row, q = arm.candidates(pose)
    assert len(row.unique()) >= 90
    error = tool_pose(arm, q) - pose[row]
    assert error.abs().max() < 2e-3
    assert bool((q >= arm.lower - 1e-9).all() and (q <= arm.upper + 1e-9).all())


def test_the_numerical_fallback_labels(tmp_path):
    robot = write(tmp_path, UPRIGHT)
    position, table = objects(24)
    near = position[:, 0].argsort()
    label = graspable(robot, position, table)[near]
    assert label[:8].float().mean() > 0.6
    far = torch.tensor([[1.5, 0.0, 0.74]]), torch.tensor([[1.8, 0, 0, 0.8, 1.4, 0.74]])
    assert graspable(robot, *far).tolist() == [False]


def test_the_closed_form_reads_lengths_and_limits(tmp_path, generator, random_joints):
    robot = write(tmp_path, REACHER)
    (arm,) = robot.arms
    assert arm.closed_form is not None
    assert len(arm.closed_form.branches) == 8
    assert arm.closed_form.upper_arm == pytest.approx(0.352)
    assert arm.closed_form.forearm == pytest.approx(0.3215)
    pose = tool_pose(arm, random_joints(arm, 1000, generator))
    row, q = arm.candidates(pose)
    assert len(row.unique()) >= 970
    assert (tool_pose(arm, q) - pose[row]).abs().max() < 1e-6
    path, reached = arm.follow(q, pose[row][:, None])
    assert reached.double().mean() > 0.999
    assert arm.difference(path[:, 0], q)[reached[:, 0]].abs().max() < 1e-5
    assert graspable(robot, *objects(50)).any()


def test_axes_may_point_the_other_way(tmp_path, generator, random_joints):
    robot = write(tmp_path, REACHER)
    text = (tmp_path / "boxer.urdf").read_text().replace('"0 1 0"', '"0 -1 0"')
    (tmp_path / "boxer.urdf").write_text(text)
    robot = load_robot(tmp_path / "boxer.urdf", tmp_path / "words.json")
    (arm,) = robot.arms
    assert arm.closed_form is not None
    pose = tool_pose(arm, random_joints(arm, 300, generator))
    row, q = arm.candidates(pose)
    assert len(row.unique()) >= 290
    assert (tool_pose(arm, q) - pose[row]).abs().max() < 1e-6


def test_a_joint_without_an_axis_turns_about_x(tmp_path):
    """So says the URDF standard; pytorch-kinematics alone would take z."""
    robot = write(tmp_path, [(None, "0 0 1", (-2, 2)), ("z", "0 0.5 0", (-2, 2))])
    pose = tool_pose(robot.arms[0], torch.tensor([math.pi / 2, 0.0]))
    torch.testing.assert_close(pose[:3, 3], torch.tensor([0.12, 0.0, 1.5]), atol=1e-6, rtol=0)


def test_an_axis_of_any_length_is_a_direction(tmp_path):
    write(tmp_path, UPRIGHT)
    path = tmp_path / "boxer.urdf"
    before = load_robot(path, tmp_path / "words.json")
    path.write_text(path.read_text().replace('"0 1 0"', '"0 2.5 0"'))
    after = load_robot(path, tmp_path / "words.json")
    q = torch.linspace(-1, 1, 7)
    torch.testing.assert_close(tool_pose(before.arms[0], q), tool_pose(after.arms[0], q))


def test_the_description_is_looked_for_beside_the_urdf(tmp_path):
    write(tmp_path, UPRIGHT)
    (tmp_path / "words.json").rename(tmp_path / "robot.json")
    assert load_robot(str(tmp_path / "boxer.urdf")).description.name == "boxer"
