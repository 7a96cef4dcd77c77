"""The best grasp by each line: compiled, line after line, against torch, all lines at once."""

from dataclasses import replace

import pytest
import torch
from test_grasping import random_scene

from cgtorch import native
from cgtorch.tabletop.kinematics import grasp_lines
from cgtorch.tabletop.kinematics.grasp_lines import (
    HALF,
    Lines,
    grasps,
    grasps_in_torch,
)
from cgtorch.tabletop.kinematics.grasping import APPROACHES, table_slab, waypoints
from cgtorch.tabletop.kinematics.way_search import places_of

OBJECTS = 150
TRIED = [0, 1, 2, 3, 9, 13, 14, 15, 20]


def asked(robot, which, dtype=torch.float64, seed=7):
    """Lines of some approaches to random objects, as `grasps` is asked about them."""
    position, table = random_scene(OBJECTS, seed=seed, dtype=dtype)
    approach = torch.tensor(APPROACHES)[TRIED].to(position)
    row = torch.arange(OBJECTS).repeat_interleave(len(approach))
    path = waypoints(position[row], *approach.repeat(OBJECTS, 1).unbind(1))
    slab = table_slab(table)
    lines = Lines(path, row, torch.arange(len(row)))
    return robot, which, lines, slab, robot.body.to(position), places_of(position, slab)


@pytest.fixture
def question(robot_and_arm):
    robot, arm = robot_and_arm
    return asked(robot, robot.arms.index(arm))


def compiled(question):
    found = grasp_lines._grasps_compiled(*question)
    if found is None:
        pytest.skip("nothing is compiled here")
    return found


def test_compiled_grasps_are_those_in_torch(question):
    ours, plain = compiled(question), grasps_in_torch(*question)
    assert len(plain.row) > 20
    assert torch.equal(ours.row, plain.row)
    assert torch.equal(ours.rank, plain.rank)
    assert torch.equal(ours.straight, plain.straight)
    torch.testing.assert_close(ours.line, plain.line, atol=1e-6, rtol=0)
    torch.testing.assert_close(ours.held, plain.held, atol=1e-9, rtol=0)


@pytest.mark.parametrize(("near", "tried"), [(1, 1), (9, 5)])
def test_they_are_whatever_is_looked_at(pr2, monkeypatch, near, tried):
    monkeypatch.setattr(grasp_lines, "NEAR", near)
    monkeypatch.setattr(grasp_lines, "TRIED", tried)
    test_compiled_grasps_are_those_in_torch(asked(pr2, 1, seed=8))


def test_some_grasps_cannot_be_reached_straight(pr2):
    """So that the comparison is about both kinds."""
    straight = grasps(*asked(pr2, 0)).straight
    assert 0 < int((~straight).sum()) < len(straight)


def test_grasps_do_not_depend_on_threads_or_on_other_lines(question):
    robot, which, lines, *rest = question
    whole = compiled(question)
    native.use_threads(3)
    shared = grasps(*question)
    native.use_threads(0)
    assert all(map(torch.equal, vars(whole).values(), vars(shared).values()))
    few = torch.arange(len(lines.row)) % 3 == 0
    alone = grasps(robot, which, Lines(*(x[few] for x in vars(lines).values())), *rest)
    same = few[whole.rank]
    assert all(map(torch.equal, vars(whole[same]).values(), vars(alone).values()))


def test_single_precision_makes_hardly_a_difference(pr2):
    question = asked(pr2, 0, torch.float32)
    ours, plain = grasps(*question), grasps_in_torch(*question)
    assert len(set(ours.rank.tolist()) ^ set(plain.rank.tolist())) <= 1


def test_an_arm_without_a_closed_form_is_looked_at_in_torch(pr2):
    arms = tuple(replace(arm, closed_form=None) for arm in pr2.arms)
    robot, which, lines, *rest = asked(pr2, 0)
    few = Lines(lines.path[:4], lines.row[:4], lines.rank[:4])
    other = replace(robot, arms=arms)
    assert grasp_lines._grasps_compiled(other, which, few, *rest) is None
    assert grasps(other, which, few, *rest).line.shape[1:] == (2 * HALF + 1, 7)


def test_no_lines(pr2):
    robot, which, lines, *rest = asked(pr2, 0)
    none = Lines(lines.path[:0], lines.row[:0], lines.rank[:0])
    assert grasps(robot, which, none, *rest).row.shape == (0,)
    assert grasps_in_torch(robot, which, none, *rest).row.shape == (0,)
