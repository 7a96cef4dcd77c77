"""Arms in which joints follow others: a hand that stays level, and a telescope."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support import tool_pose
from test_other_robots import objects

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import Robot, arm_ways, load_robot
from cgtorch.tabletop.kinematics.clear_ways import OWN, REACH, TABLE, Places, ways_clear

ROWS = (
    ("pan", "revolute", "0 0 1", "0.1 0 0.7", "-3 3", None),
    ("lift", "revolute", "0 1 0", "0 0 0.1", "-2 2", None),
    ("level", "continuous", "0 1 0", "0.2 0 0", None, ("lift", -0.6, 0.3)),
    ("bend", "revolute", "0 1 0", "0.2 0 0", "-2 2", None),
    ("out", "prismatic", "1 0 0", "0.1 0 0", "0 0.2", None),
    ("further", "prismatic", "1 0 0", "0.1 0 0", "-1 1", ("out", 1.5, 0.1)),
    ("roll", "continuous", "1 0 0", "0.05 0 0", None, None),
    ("nod", "revolute", "0 1 0", "0.05 0 0", "-2 2", None),
    ("tilt", "revolute", "0 0 1", "0.05 0 0", "-2 2", None),
)
OWN_NAMES = ("pan", "lift", "bend", "out", "roll", "nod", "tilt")


def urdf_of(rows):
    parts, parent = ['<robot name="a"><link name="base"/>'], "base"
    for name, kind, axis, xyz, ends, follows in rows:
        low, high = ends.split() if ends else (0, 0)
        mimic = ""
        if follows:
            mimic = '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*follows)
        origin = f'<origin xyz="{xyz}" rpy="0.1 0.2 -0.3"/>' if xyz else ""
        limit = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>' if ends else ""
        parts.append(
            f'<link name="{name}"><collision><origin xyz="0.03 0.01 0"/><geometry>'
            '<box size="0.06 0.02 0.03"/></geometry></collision></link>'
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
            f'{origin}<axis xyz="{axis}"/>{limit}{mimic}</joint>'
        )
        parent = name
    parts.append('<link name="tool"/><joint name="t" type="fixed"><child link="tool"/>')
    parts.append(f'<parent link="{parent}"/><origin xyz="0.12 0 0"/></joint></robot>')
    return "".join(parts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("coupled")


def read(folder, rows):
    words = '{"name": "a", "base_frame": "base", "footprint": [-0.2, 0.2, -0.2, 0.2], '
    words += '"torso_joint": null, "torso_position": null, '
    words += '"arms": [{"name": "arm", "base_link": "base", "tool_frame": "tool"}]}'
    (folder / "robot.json").write_text(words)
    (folder / "a.urdf").write_text(urdf_of(rows))
    return load_robot(folder / "a.urdf")


@pytest.fixture(scope="module")
def robot(folder) -> Robot:
    return read(folder, ROWS)


@pytest.fixture(scope="module")
def free(folder, robot) -> Robot:
    """The same arm, whose joints follow none."""
    return read(folder, [(*row[:5], None) for row in ROWS])


def every(q):
    """(B, 9): positions of all joints at those (B, 7) of the joints that follow none."""
    named = dict(zip(OWN_NAMES, q.T, strict=True))
    columns = []
    for name, *_, follows in ROWS:
        lead, factor, offset = follows or (name, 1.0, 0.0)
        columns.append(offset + factor * named[lead])
    return torch.stack(columns, dim=1)


def test_tool_frames_agree_with_yourdfpy(robot, random_joints, generator):
    assert robot.arms[0].joint_names == OWN_NAMES
    agrees_with_yourdfpy(robot, random_joints, generator)


def test_joints_that_follow_may_have_no_origin(folder, random_joints, generator):
    rows = [(*row[:3], None if row[5] else row[3], *row[4:]) for row in ROWS]
    agrees_with_yourdfpy(read(folder, rows), random_joints, generator)


def test_single_precision_is_as_good(robot, random_joints, generator):
    q = random_joints(robot.arms[0], 20, generator)
    assert (tool_pose(robot.arms[0], q.float()) - tool_pose(robot.arms[0], q)).abs().max() < 1e-5


def test_a_table_says_which_joint_moves_each_frame_and_how_far(robot):
    (arm,) = robot.arms
    table = arm.chain(arm.lower)[1]
    assert table.joint[table.joint >= 0].tolist() == [0, 1, 1, 2, 3, 3, 4, 5, 6]
    assert table.joint.tolist().count(-1) == 2
    assert table.gain[table.joint >= 0].tolist() == [1, 1, -0.6, 1, 1, 1.5, 1, 1, 1]
    assert table.axis[table.joint < 0].tolist() == [[0, 0, 0]] * 2


def test_of_each_solid_the_joints_that_follow_none_are_counted(robot, free):
    assert robot.arms[0].solids.joints.tolist() == [1, 2, 2, 3, 4, 4, 5, 6, 7]
    assert free.arms[0].solids.joints.tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 9]


def agrees_with_yourdfpy(robot, random_joints, generator):
    (arm,), model = robot.arms, robot.urdf.model
    q = random_joints(arm, 50, generator)
    for angles, pose in zip(q, tool_pose(arm, q), strict=True):
        model.update_cfg(dict(zip(arm.joint_names, angles.tolist(), strict=True)))
        want = model.get_transform("tool", "base")
        np.testing.assert_allclose(pose.numpy(), want, atol=1e-6)


def test_a_joint_follows_one_before_it(folder):
    rows = [(*row[:5], ("bend", 1.0, 0.0)) if row[0] == "level" else row for row in ROWS]
    message = "arm 'arm' has the mimic joint 'level', which follows 'bend': use an arm of rev"
    with pytest.raises(RobotError, match=message):
        read(folder, rows)


def test_an_arm_does_not_move_its_own_base(folder):
    rows = [*ROWS]
    rows[0] = (*rows[0][:5], ("lift", 1, 0))
    with pytest.raises(RobotError, match=r"'pan', which follows 'lift'.* in a robot folder by cgt"):
        read(folder, rows)
    words = (folder / "robot.json").read_text()
    (folder / "robot.json").write_text(words.replace('"base_link": "base"', '"base_link": "pan"'))
    with pytest.raises(RobotError, match="'pan' moves, as it follows 'lift' of the arm: begin the"):
        load_robot(folder / "a.urdf")


def test_a_joint_may_follow_one_that_follows(folder):
    rows = [(*row[:5], ("level", 2.0, 0.1)) if row[0] == "further" else row for row in ROWS]
    (arm,) = read(folder, rows).arms
    gains = arm.chain(arm.lower)[0].gains
    assert gains[OWN_NAMES.index("lift")].tolist() == pytest.approx(
        [0, 1, -0.6, 0, 0, -1.2, 0, 0, 0]
    )


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_a_joint_of_an_arm_moves_in_one_way(folder, kind):
    rows = [(row[0], kind, *row[2:4], None, None) if row[0] == "roll" else row for row in ROWS]
    with pytest.raises(RobotError, match=f"arm 'arm' has the {kind} joint 'roll': use an arm of"):
        read(folder, rows)


def test_an_arm_of_seven_joints_of_which_one_follows_has_no_closed_form(folder):
    """Even if it has one without this."""
    whole, (text, words) = load_robot(), (folder / "b.urdf", folder / "robot.json")
    assert whole.arms[0].closed_form is not None
    elbow = '<parent link="l_upper_arm_link"/>'
    urdf = whole.urdf.path.read_text()
    assert urdf.count(elbow + '<child link="l_elbow_flex_link"/>') == 1
    follows = '<mimic joint="l_shoulder_lift_joint" multiplier="-1"/>'
    text.write_text(
        urdf.replace(elbow + '<child link="l_elb', follows + elbow + '<child link="l_elb')
    )
    words.write_text((whole.urdf.path.parent / "robot.json").read_text())
    arm = load_robot(text).arms[0]
    assert (len(arm.joint_names), arm.closed_form) == (6, None)


def test_jacobians_are_differences_of_poses(robot, random_joints, generator):
    chain = robot.arms[0].chain(torch.zeros(1).double())[0]
    (q,) = random_joints(robot.arms[0], 1, generator)
    jacobian, pose = chain.jacobian(q[None], ret_eef_pose=True)
    assert torch.equal(chain.jacobian(q[None]), jacobian)
    assert torch.equal(chain.forward_kinematics(q[None]).get_matrix(), pose)
    step = 1e-6
    for k in range(7):
        ends = [tool_pose(robot.arms[0], q + sign * step * torch.eye(7)[k]) for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        torch.testing.assert_close(jacobian[0, :3, k], slope[:3, 3], atol=1e-5, rtol=0)
        turn = slope[:3, :3] @ pose[0, :3, :3].T
        spin = torch.stack([turn[2, 1], turn[0, 2], turn[1, 0]])
        torch.testing.assert_close(jacobian[0, 3:, k], spin, atol=1e-5, rtol=0)


def test_poses_are_reached(robot, random_joints, generator):
    (arm,) = robot.arms
    assert arm.closed_form is None
    assert arm.freedom == 6
    pose = tool_pose(arm, random_joints(arm, 60, generator))
    row, q = arm.candidates(pose)
    assert len(row.unique()) >= 48
    assert (tool_pose(arm, q) - pose[row]).abs().max() < 2e-3


def test_compiled_code_moves_the_same_shapes(robot, free, random_joints, generator):
    """Near a table, a posture of the coupled arm is as clear as that of the free one."""
    (one,), (other,) = robot.arms, free.arms
    q = random_joints(one, 300, generator)
    table = torch.eye(3, 4).double().expand(300, 3, 4).clone()
    table[:, 2, 3] = 0.75
    size = torch.tensor([0.5, 0.5, 0.02, 0, 0]).double().expand(300, 5)
    away = torch.eye(3, 4).double().expand(300, 3, 4)
    places, kind = Places(table, size, away, away), torch.full((300,), REACH)
    found = []
    for arm, which, at in ((one, robot, q), (other, free, every(q))):
        scene = which.scenes[0]
        kept = (scene.pairs[:, 0] >= OWN) & (scene.pairs[:, 1] == TABLE)
        alone = replace(scene, pairs=scene.pairs[kept], reach=scene.reach[kept])
        found.append(ways_clear(arm, alone, places, kind, at[:, None]))
    assert torch.equal(*found)
    assert 30 < int(found[0].sum()) < 270


def test_no_solid_comes_nearer_than_its_reach_says(robot, random_joints, generator):
    """Of each pair of the arm's own solids, whose middles are compared."""
    (arm,), scene = robot.arms, robot.scenes[0]
    begin = random_joints(arm, 200, generator)
    end = begin + 0.2 * (random_joints(arm, 200, generator) - begin)
    inner = ((scene.pairs[:, :2] >= OWN) & (scene.frame[scene.pairs[:, :2]] >= 0)).all(1)
    pairs, reach = scene.pairs[inner, :2], scene.reach[inner]
    assert len(pairs) > 10

    def apart(q):
        frames = arm.frames(q)
        pose = frames[scene.frame.clamp_min(0)]
        middle = (pose[..., :3, :3] @ scene.pose[:, None, :, 3:])[..., 0] + pose[..., :3, 3]
        return (middle[pairs[:, 0]] - middle[pairs[:, 1]]).norm(dim=-1)

    most = reach @ (end - begin).abs().T
    nearer = (apart(end) - apart(begin)).abs()
    assert bool((nearer <= most + 1e-9).all())
    assert float((nearer / most).max()) > 0.3


def test_it_finds_ways_to_objects(robot):
    position, table = objects(6)
    ways = arm_ways(robot, position, table)
    assert ways.joints.shape[-1] == 7
    assert ways.found.any()
