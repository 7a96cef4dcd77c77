from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch
from torch import Tensor

from cgtorch.graphs import Graphs, Skill
from cgtorch.runs.skills import last_skill
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT, LIFT, table_slab
from cgtorch.tabletop.kinematics.touching import touches
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.viewer.timeline import (
    DRIVE,
    FPS,
    SWING,
    TURN,
    Timeline,
    joint_names,
    timeline_of,
)
from cgtorch.tabletop.world import draw_of
from cgtorch.tabletop.world.geometry import rectangle_in_frame, rotate, wrap

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
COUNT = 4


@cache
def opened() -> tuple[StoredRun, Skill]:
    return last_skill(REFERENCE)


@cache
def timeline(number: int) -> Timeline:
    run, skill = opened()
    scenarios = draw_of("perimeter")(COUNT, torch.Generator().manual_seed(0))
    execution = execute(skill, run.domain.world(scenarios), number)
    return timeline_of(execution, run.domain.robot)


@pytest.mark.parametrize("number", range(COUNT))
def test_every_step_ends_where_the_world_says(number: int) -> None:
    one = timeline(number)
    run = one.execution
    assert len({len(x) for x in (one.pose, one.joints, one.object, one.step, one.seen)}) == 1
    for k in range(len(run.steps)):
        frames = (one.step == k).nonzero()[:, 0]
        assert one.start_of(k) == int(frames[0])
        away = one.pose[int(frames[-1])] - run.pose[k + 1]
        assert float(away[:2].norm() + wrap(away[2:]).abs()) < 1e-5
        assert int(one.seen[int(frames[-1])]) == k + 1
        assert set(one.seen[frames[:-1]].tolist()) <= {k, len(run.steps)}
    assert one.start_of(len(run.steps)) == len(one) - 1
    assert (one.step[1:] >= one.step[:-1]).all()
    assert torch.equal(one.pose[0, 2:], run.pose[0, 2:])


@pytest.mark.parametrize("number", range(COUNT))
def test_nothing_jumps(number: int) -> None:
    one = timeline(number)
    driven = (one.pose[1:, :2] - one.pose[:-1, :2]).norm(dim=1)
    turned = wrap(one.pose[1:, 2] - one.pose[:-1, 2]).abs()
    assert float(driven.max()) <= 1.5 * DRIVE / FPS
    assert float(turned.max()) <= 1.5 * TURN / FPS
    assert not (driven * turned > 1e-6).any()  # it drives straight, then turns
    assert float((one.joints[1:] - one.joints[:-1]).abs().max()) <= 1.5 * SWING / FPS
    lifted = (one.object[1:] - one.object[:-1]).norm(dim=1)
    assert float(lifted.max()) <= 0.03


def tool_at(one: Timeline, frame: int, which: int) -> Tensor:
    """Where an arm's tool is in the world, by yourdfpy's own kinematics of all joints."""
    robot = opened()[0].domain.robot
    model = robot.urdf.model
    words = robot.description
    model.update_cfg(
        {
            words.torso_joint: words.torso_position,
            **dict(zip(joint_names(robot), one.joints[frame].tolist(), strict=True)),
        }
    )
    at = torch.tensor(model.get_transform(words.arms[which].tool_frame, words.base_frame)[:3, 3])
    x, y, turn = one.pose[frame].double()
    return torch.cat([rotate(at[:2], turn) + torch.stack([x, y]), at[2:]])


@pytest.mark.parametrize("number", range(COUNT))
def test_the_arm_really_reaches_and_lifts_the_object(number: int) -> None:
    one = timeline(number)
    assert one.execution.end == "success"
    moved = (one.object[:, 2] > one.object[0, 2] + 1e-4).nonzero()[:, 0]
    held = [int(moved[0]) - 1, int(moved[len(moved) // 2]), len(one) - 1]
    up = torch.tensor([0.0, 0.0, GRASP_HEIGHT])
    for frame in held:
        away = [float((tool_at(one, frame, i) - one.object[frame] - up).norm()) for i in (0, 1)]
        assert min(away) < 0.01, (frame, away)
    assert float(one.object[-1, 2] - one.object[0, 2]) == pytest.approx(LIFT, abs=1e-3)
    torch.testing.assert_close(one.object[:, :2], one.object[:1, :2].expand(len(one), 2))


@pytest.mark.parametrize("number", range(COUNT))
def test_the_arms_touch_nothing_on_their_way(number: int) -> None:
    one = timeline(number)
    robot, scene = opened()[0].domain.robot, one.execution.scenario
    last = one.step == one.step[-1]
    pose, joints = one.pose[last].double(), one.joints[last].double()
    seen = rectangle_in_frame(pose, scene.table[0, :5].double().expand(len(pose), 5))
    slab = table_slab(torch.cat([seen, scene.table[0, 5:].double().expand(len(pose), 1)], 1))
    first = 0
    for arm in robot.arms:
        mine = joints[:, first : first + len(arm.joint_names)]
        first += len(arm.joint_names)
        # Ways are looked at in many places, between which there may be a graze.
        assert not touches(arm, mine, replace(slab, half=slab.half - 0.002), robot.body).any()


def grasping_on_and_on() -> Skill:
    """Grasps where the robot stands at first, where nothing can be reached, again and again."""
    actions = paper_actions()
    grasp, drive = actions.index("Grasp"), actions.index("MoveBase")
    edges = torch.tensor([[[-1, 1], [0, 0]]])
    parameters = torch.zeros(1, 2, actions.parameter_capacity)
    start = torch.zeros(1, dtype=torch.long)
    graph = Graphs(torch.tensor([[grasp, drive]]), edges, parameters, start)
    return Skill("Again", graph, actions, max_transitions=4)


def test_what_fails_moves_no_arm() -> None:
    run, _ = opened()
    scenarios = draw_of("far")(1, torch.Generator().manual_seed(1))
    failed = execute(grasping_on_and_on(), run.domain.world(scenarios), 0)
    assert failed.end != "success"
    assert any(step.name == "Grasp" for step in failed.steps)
    one = timeline_of(failed, run.domain.robot)
    assert torch.equal(one.joints, one.joints[:1].expand_as(one.joints))
    assert torch.equal(one.object, one.object[:1].expand_as(one.object))
