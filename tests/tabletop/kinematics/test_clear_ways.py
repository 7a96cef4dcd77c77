"""Ways that are clear, against another distance of the solids, and planned where they are not."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from test_grasping import random_scene

from cgtorch import native
from cgtorch.ground.errors import CompilerError, RobotError
from cgtorch.native import library
from cgtorch.tabletop.kinematics import arm_ways, clear_ways, graspable, has_posture
from cgtorch.tabletop.kinematics.arm_way import row_keys
from cgtorch.tabletop.kinematics.clear_ways import (
    APPROACH,
    CARRY,
    HELD,
    LIFT,
    MARGIN,
    OBJECT,
    OWN,
    POSTURE,
    REACH,
    TABLE,
    VIAS,
    ways_clear,
    ways_planned,
)
from cgtorch.tabletop.kinematics.grasping import places_of

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from benchmarks.touching import NEAR, gaps

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
    places = replace(places_of(position, table), held=held)
    return arm, robot.scenes[which], places, torch.full((rows,), REACH), ways


def test_ways_are_clear_where_nothing_is_near_on_them(robot_and_arm, random_joints, generator):
    """What is not clear comes near between two of the postures, up to what it moves meanwhile."""
    arm, scene, places, kind, ways = asked(*robot_and_arm, random_joints, generator, rows=40)
    low, high = torch.full((2, len(ways), len(scene.pairs)), torch.inf, dtype=ways.dtype)
    for share in torch.linspace(0, 1, 21).tolist():
        for a, b in ((0, 1), (1, 2)):
            q = ways[:, a] + share * (ways[:, b] - ways[:, a])
            lower, upper = gaps(arm, scene, places, q, -1)
            low, high = low.minimum(lower), high.minimum(upper)
    for one in (REACH, APPROACH, LIFT, CARRY, POSTURE):
        clear = ways_clear(arm, scene, places, torch.full_like(kind, one), ways)
        assert 0.02 < clear.double().mean() < 0.98
        asked_for = scene.pairs[:, 2] & one > 0
        assert bool((high[clear][:, asked_for] >= MARGIN - 1e-5).all())
        assert bool((low[~clear][:, asked_for].amin(1) < NEAR).all())


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


def test_a_way_that_rests_on_its_way_is_looked_at_where_it_moves(pr2, random_joints):
    """Before or after the middle, where alone the arm is looked at first."""
    arm, scene, places, kind, ways = asked(
        pr2, pr2.arms[1], random_joints, torch.Generator().manual_seed(4), 300, joints=2
    )
    a, b = ways.unbind(1)
    whole = ways_clear(arm, scene, places, kind, ways)
    at_rest = [ways_clear(arm, scene, places, kind, q[:, None]) for q in (a, b)]
    assert (at_rest[0] & at_rest[1] & ~whole).any()
    for way in ((a, a, b), (a, b, b), (a, a, a, b), (a, b, b, b)):
        assert torch.equal(ways_clear(arm, scene, places, kind, torch.stack(way, 1)), whole)
    assert torch.equal(ways_clear(arm, scene, places, kind, torch.stack([b, b], 1)), at_rest[1])


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


def wall(robot: Any, random_joints: Any, rows: int = 400) -> tuple[Any, ...]:
    """Ends that are clear on both sides of a table that stands on edge, and no straight way."""
    arm, scene, places, kind, ways = asked(
        robot, robot.arms[0], random_joints, torch.Generator().manual_seed(8), rows=rows, joints=2
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


def test_compiled_code_with_room_for_other_ways_is_refused(planned, monkeypatch):
    arm, scene, places, kind, ends, key, *_ = planned
    monkeypatch.setattr(clear_ways, "VIAS", VIAS + 1)
    with pytest.raises(ImportError, match=r"Python has {'MOST_VIAS': 17}"):
        ways_planned(arm, scene, places, kind, ends, key)


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


def test_more_pairs_than_compiled_code_takes_are_refused(pr2, random_joints):
    arm, scene, places, kind, ways = asked(
        pr2, pr2.arms[0], random_joints, torch.Generator().manual_seed(3), rows=8
    )
    copies = 16_384 // len(scene.pairs) + 1
    many = replace(scene, pairs=scene.pairs.repeat(copies, 1), reach=scene.reach.repeat(copies, 1))
    with pytest.raises(RobotError, match=r"arm 'left' has \d+ pairs, .* take 16384: give it fewer"):
        ways_clear(arm, many, places, kind, ways)


def test_without_any_compiled_code_there_is_one_clear_error(pr2, monkeypatch):
    monkeypatch.setattr(library, "built", lambda dtype: None)
    object_and_table = random_scene(1, seed=0)
    for question in (graspable, has_posture, arm_ways):
        with pytest.raises(CompilerError, match="install a C compiler such as gcc"):
            question(pr2, *object_and_table)


def test_switching_compiled_code_off_leaves_arms_their_own(pr2, monkeypatch):
    asked = pr2, *random_scene(30, seed=0)
    before = graspable(*asked)
    monkeypatch.setenv("CGTORCH_NATIVE", "0")
    assert not native.available()
    assert torch.equal(graspable(*asked), before)
