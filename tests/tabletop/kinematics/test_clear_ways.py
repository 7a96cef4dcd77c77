"""Ways that are clear, compiled and in torch, and planned where they are not."""

from dataclasses import replace

import pytest
import torch
from test_grasping import random_scene

from cgtorch import native
from cgtorch.tabletop.kinematics import clear_ways, rrt_connect
from cgtorch.tabletop.kinematics.clear_ways import MARGIN, ways_clear, ways_clear_in_torch
from cgtorch.tabletop.kinematics.grasping import table_slab
from cgtorch.tabletop.kinematics.rrt_connect import VIAS, planned_in_torch, ways_planned
from cgtorch.tabletop.kinematics.scene import HELD, OBJECT, OWN, REACH, TABLE
from cgtorch.tabletop.kinematics.way_search import places_of, row_keys

ROWS = 60


def asked(robot, arm, random_joints, generator, rows=ROWS, joints=3):
    """Rows of random ways between postures beside a table before the robot."""
    which = robot.arms.index(arm)
    position, table = random_scene(rows, seed=5, dtype=torch.float64)
    q = random_joints(arm, rows * joints, generator).view(rows, joints, -1)
    middle = (q[:, :1] + robot.home[which]) / 2
    ways = torch.cat([middle, middle + 0.3 * (q[:, 1:] - middle)], 1)
    turn = torch.linalg.qr(torch.randn(rows, 3, 3, generator=generator, dtype=torch.float64))[0]
    held = torch.nn.functional.pad(turn * turn.det()[:, None, None], (0, 1))
    places = replace(places_of(position, table_slab(table)), held=held)
    return arm, robot.scenes[which], places, torch.full((rows,), REACH), ways


@pytest.mark.parametrize("kind", [1, 2, 4, 8])
def test_compiled_ways_are_clear_where_they_are_in_torch(
    robot_and_arm, random_joints, generator, kind, monkeypatch
):
    """Up to a hundredth of a millimetre, by which the margin is made smaller and larger."""
    arm, scene, places, kinds, ways = asked(*robot_and_arm, random_joints, generator)
    kinds = torch.full_like(kinds, kind)
    found = ways_clear(arm, scene, places, kinds, ways)
    said = []
    for margin in (MARGIN - 2e-5, MARGIN + 2e-5):
        monkeypatch.setattr(clear_ways, "MARGIN", margin)
        said.append(ways_clear_in_torch(arm, scene, places, kinds, ways))
    less, more = said
    assert 0.02 < found.double().mean() < 0.98
    assert torch.equal(found & less, found)
    assert torch.equal(found | more, found)


@pytest.mark.parametrize("threads", [1, 3])
def test_a_way_is_clear_whatever_the_others_and_the_threads(pr2, random_joints, threads):
    arm, scene, places, kind, ways = asked(
        pr2, pr2.arms[0], random_joints, torch.Generator().manual_seed(3)
    )
    native.use_threads(threads)
    found = ways_clear(arm, scene, places, kind, ways)
    one = [
        ways_clear(arm, scene, places[torch.tensor([i])], kind[:1], ways[i : i + 1])
        for i in range(20)
    ]
    native.use_threads(0)
    assert torch.equal(found[:20], torch.cat(one))


def test_a_clear_way_has_no_posture_that_touches(robot_and_arm, random_joints, generator):
    arm, scene, places, kind, ways = asked(*robot_and_arm, random_joints, generator)
    clear = ways_clear(arm, scene, places, kind, ways)
    for share in torch.linspace(0, 1, 41).tolist():
        for a, b in ((0, 1), (1, 2)):
            at = ways[:, a] + share * (ways[:, b] - ways[:, a])
            alone = ways_clear(arm, scene, places, kind, at[:, None])
            assert bool(alone[clear].all())


def test_only_moving_solids_come_first_and_neighbours_are_left_out(robot_and_arm):
    robot, arm = robot_and_arm
    scene = robot.scenes[robot.arms.index(arm)]
    assert bool((scene.frame[scene.pairs[:, 0]] >= 0).all())
    assert not bool(((scene.pairs[:, 1] >= TABLE) & (scene.pairs[:, 1] == HELD)).any())
    joints = torch.cat([torch.zeros(OWN, dtype=torch.long), arm.solids.joints])
    own = (scene.pairs[:, :2] >= OWN).all(1) & (scene.frame[scene.pairs[:, 1]] >= 0)
    a, b = scene.pairs[own, 0], scene.pairs[own, 1]
    assert bool((joints[a] > joints[b] + 1).all())
    assert OBJECT in scene.pairs[:, 1]


def wall(robot, random_joints):
    """Ends that are clear on both sides of a table that stands on edge, and no straight way."""
    arm, scene, places, kind, ways = asked(
        robot, robot.arms[0], random_joints, torch.Generator().manual_seed(8), rows=400, joints=2
    )
    ends = torch.stack([robot.home[0].expand_as(ways[:, 1]), ways[:, 1]], 1)
    free = ways_clear(arm, scene, places, kind, ends[:, 1:])
    hard = (free & ~ways_clear(arm, scene, places, kind, ends)).nonzero()[:, 0]
    return arm, scene, places[hard], kind[hard], ends[hard]


@pytest.fixture(scope="module")
def planned(pr2, random_joints):
    arm, scene, places, kind, ends = wall(pr2, random_joints)
    key = row_keys(ends[:, 0, :3], ends[:, 1, :6], 0)
    return arm, scene, places, kind, ends, key, *ways_planned(arm, scene, places, kind, ends, key)


def test_planned_ways_are_clear_from_end_to_end(planned):
    arm, scene, places, kind, ends, _, ways, count = planned
    found = count > 0
    assert found.double().mean() > 0.5
    assert bool((count[found] > 2).all())
    last = torch.arange(VIAS).minimum(count.clamp_min(1)[:, None] - 1)
    whole = ways.gather(1, last[..., None].expand_as(ways))[found]
    torch.testing.assert_close(whole[:, 0], ends[found, 0])
    torch.testing.assert_close(whole[:, -1], ends[found, 1])
    assert bool(ways_clear(arm, scene, places[found], kind[found], whole).all())


def test_a_plan_depends_on_its_key_alone(planned):
    arm, scene, places, kind, ends, key, ways, count = planned
    row = torch.tensor([len(ends) - 1])
    alone = ways_planned(arm, scene, places[row], kind[row], ends[row], key[row])
    assert torch.equal(alone[0], ways[row])
    assert torch.equal(alone[1], count[row])


def test_compiled_plans_are_those_in_torch(planned, monkeypatch):
    arm, scene, places, kind, ends, key, ways, count = planned
    same = 0
    for row in range(5):
        one = torch.tensor([row])
        clear = lambda a, b, one=one: bool(  # noqa: E731
            ways_clear(arm, scene, places[one], kind[one], torch.stack([a, b])[None])[0]
        )
        low, high = rrt_connect._bounds(arm, ends[one])
        way = planned_in_torch(clear, ends[row], low[0], high[0], key[row])
        same += len(way) == count[row] and all(
            torch.allclose(a, b, atol=1e-9) for a, b in zip(way, ways[row], strict=False)
        )
    assert same == 5


def test_no_way_leads_to_a_posture_that_touches(pr2, random_joints):
    arm, scene, places, kind, ways = asked(
        pr2, pr2.arms[0], random_joints, torch.Generator().manual_seed(9)
    )
    bad = ~ways_clear(arm, scene, places, kind, ways[:, 1:2])
    ends = torch.stack([pr2.home[0].expand_as(ways[:, 1]), ways[:, 1]], 1)[bad][:3]
    row = bad.nonzero()[:3, 0]
    key = torch.arange(len(row))
    _, count = ways_planned(arm, scene, places[row], kind[row], ends, key)
    assert count.tolist() == [0] * len(row)


def test_more_pairs_than_compiled_code_takes_are_tried_in_torch(pr2, random_joints, monkeypatch):
    arm, scene, places, kind, ways = asked(
        pr2, pr2.arms[0], random_joints, torch.Generator().manual_seed(3), rows=8
    )
    copies = 4096 // len(scene.pairs) + 1
    many = replace(scene, pairs=scene.pairs.repeat(copies, 1), reach=scene.reach.repeat(copies, 1))
    assert clear_ways.ways_task(arm, many, places, kind, ways) is None
    assert torch.equal(
        ways_clear(arm, many, places, kind, ways), ways_clear(arm, scene, places, kind, ways)
    )
