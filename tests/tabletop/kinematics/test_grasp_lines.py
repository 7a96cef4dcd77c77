"""The best grasp by each line: of arms with a closed form against the search for any arm."""

from dataclasses import replace

import pytest
import torch
from test_grasping import random_scene

from cgtorch import native
from cgtorch.tabletop.kinematics import grasp_lines
from cgtorch.tabletop.kinematics.clear_ways import LIFT
from cgtorch.tabletop.kinematics.grasp_lines import HALF, grasps, grasps_of_any_arm
from cgtorch.tabletop.kinematics.grasping import APPROACHES, Lines, places_of, waypoints

OBJECTS = 150
TRIED = [0, 1, 2, 3, 9, 13, 14, 15, 20]


def asked(robot, which, dtype=torch.float64, seed=7):
    """Lines of some approaches to random objects, as `grasps` is asked about them."""
    position, table = random_scene(OBJECTS, seed=seed, dtype=dtype)
    approach = torch.tensor(APPROACHES)[TRIED].to(position)
    row = torch.arange(OBJECTS).repeat_interleave(len(approach))
    path = waypoints(position[row], *approach.repeat(OBJECTS, 1).unbind(1))
    lines = Lines(path, row, torch.arange(len(row)))
    return robot, which, lines, places_of(position, table)


@pytest.fixture
def question(robot_and_arm):
    robot, arm = robot_and_arm
    return asked(robot, robot.arms.index(arm))


def test_grasps_in_closed_form_are_those_of_the_search(question):
    ours, plain = grasps(*question), grasps_of_any_arm(*question)
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
    test_grasps_in_closed_form_are_those_of_the_search(asked(pr2, 1, seed=8))


def test_some_grasps_cannot_be_reached_straight(pr2):
    """So that the comparison is about both kinds."""
    straight = grasps(*asked(pr2, 0)).straight
    assert 0 < int((~straight).sum()) < len(straight)


def test_grasps_do_not_depend_on_threads_or_on_other_lines(question):
    robot, which, lines, places = question
    whole = grasps(*question)
    native.use_threads(3)
    shared = grasps(*question)
    native.use_threads(0)
    assert all(map(torch.equal, vars(whole).values(), vars(shared).values()))
    few = torch.arange(len(lines.row)) % 3 == 0
    alone = grasps(robot, which, lines[few], places)
    same = few[whole.rank]
    assert all(map(torch.equal, vars(whole[same]).values(), vars(alone).values()))


def test_an_object_is_lifted_from_where_it_stands(pr2, monkeypatch):
    """It has the pose in the tool frame that it has when the tool arrives."""
    clear, lifted = grasp_lines.ways_clear, 0

    def noted(arm, scene, places, kind, ways):
        nonlocal lifted
        if (kind == LIFT).all():
            tool = arm.frames(ways[:, 0])[-1, :, :3]
            held = tool[..., :3] @ places.held
            held[..., 3] += tool[..., 3]
            torch.testing.assert_close(held, places.object, atol=1e-6, rtol=0)
            lifted += len(kind)
        return clear(arm, scene, places, kind, ways)

    monkeypatch.setattr(grasp_lines, "ways_clear", noted)
    robot, which, lines, places = asked(pr2, 0)
    grasps_of_any_arm(robot, which, lines[:300], places)
    assert lifted > 10


def test_single_precision_makes_hardly_a_difference(pr2):
    question = asked(pr2, 0, torch.float32)
    ours, plain = grasps(*question), grasps_of_any_arm(*question)
    assert len(set(ours.rank.tolist()) ^ set(plain.rank.tolist())) <= 1


def test_an_arm_without_a_closed_form_is_searched_numerically(pr2):
    arms = tuple(replace(arm, closed_form=None) for arm in pr2.arms)
    robot, which, lines, places = asked(pr2, 0)
    found = grasps(replace(robot, arms=arms), which, lines[torch.arange(4)], places)
    assert found.line.shape[1:] == (2 * HALF + 1, 7)


def test_no_lines(pr2):
    robot, which, lines, places = asked(pr2, 0)
    assert grasps(robot, which, lines[:0], places).row.shape == (0,)
    assert grasps_of_any_arm(robot, which, lines[:0], places).row.shape == (0,)
