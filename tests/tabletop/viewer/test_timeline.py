"""Pictures in time: those of the kinematic world, and those of what is simulated in physics."""

from dataclasses import replace
from functools import cache
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import torch
from torch import Tensor

from cgtorch.graphs import Graphs, Skill, Step
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import Detect, Grasp, paper_actions
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import clear_ways
from cgtorch.tabletop.kinematics.clear_ways import POSTURE
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT, LIFT, places_of
from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.grasp import LIFTED
from cgtorch.tabletop.physics.world import drives, grasps
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.viewer.timeline import (
    DRIVE,
    FPS,
    LOOK,
    REST,
    SWING,
    THINK,
    TURN,
    Recorder,
    Timeline,
    _count,
    _drive,
    _line,
    _upwards,
    contacts_of,
    joint_names,
    laid_out,
    seconds_of,
    simulated_timeline,
    timeline_of,
)
from cgtorch.tabletop.world import draw_of
from cgtorch.tabletop.world.geometry import rectangle_in_frame, rotate, wrap

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
COUNT = 4
SCENE = [-0.95, 0.0, 0.0, 0, 0, 0, 0.8, 1.2, 0.74, -0.3, 0.1, 0.79, 1, 0, 0, 0]


@cache
def opened() -> tuple[StoredRun, Skill]:
    return last_skill(REFERENCE)


@cache
def timeline(number: int) -> Timeline:
    run, skill = opened()
    scenarios = draw_of("perimeter")(COUNT, torch.Generator().manual_seed(0))
    execution = execute(skill, run.domain.world(scenarios), number)
    return timeline_of(execution, run.domain.robot)


@cache
def simulated() -> Timeline:
    run, skill = opened()
    domain = run.domain.in_world("mujoco")
    assert isinstance(domain, Tabletop)
    scenario = draw_of("perimeter")(3, torch.Generator().manual_seed(4))[torch.tensor([1])]
    one = simulated_timeline(skill, domain, scenario)
    usual = execute(skill, domain.world(scenario))
    assert one.execution.end == usual.end == "success"
    assert torch.equal(one.execution.pose, usual.pose), "being watched changes nothing"
    return one


@pytest.mark.parametrize("number", [*range(COUNT), None])
def test_every_step_ends_where_the_world_says(number: int | None) -> None:
    one = simulated() if number is None else timeline(number)
    run = one.execution
    rows = one.pose, one.joints, one.object, one.turned, one.contacts, one.step, one.seen
    assert {len(x) for x in rows} == {len(one)}
    for k, step in enumerate(run.steps):
        frames = (one.step == k).nonzero()[:, 0]
        assert one.start_of(k) == int(frames[0])
        away = one.pose[int(frames[-1])] - run.pose[k + 1]
        if number is not None or step.name != "Grasp":  # in which a simulated base gives way
            assert float(away[:2].norm() + wrap(away[2:]).abs()) < 1e-5
        assert int(one.seen[int(frames[-1])]) == k + 1
        assert set(one.seen[frames[:-1]].tolist()) <= {k, len(run.steps)}
    assert one.start_of(len(run.steps)) == len(one) - 1
    assert (one.step[1:] >= one.step[:-1]).all()
    assert torch.equal(one.pose[0, 2:], run.pose[0, 2:]) or number is None


@pytest.mark.parametrize("number", range(COUNT))
def test_nothing_jumps(number: int) -> None:
    one = timeline(number)
    driven, lifted = one.pose[:, :2].diff(dim=0).norm(dim=1), one.object.diff(dim=0).norm(dim=1)
    turned = wrap(one.pose[:, 2].diff()).abs()
    assert float(driven.max()) <= 1.5 * DRIVE / FPS
    assert float(turned.max()) <= 1.5 * TURN / FPS
    assert not (driven * turned > 1e-6).any()  # it drives straight, then turns
    assert float(one.joints.diff(dim=0).abs().max()) <= 1.5 * SWING / FPS
    assert float(lifted.max()) <= 0.03
    assert one.turned.unique(dim=0).tolist() == [[1, 0, 0, 0]]


def tool_at(one: Timeline, frame: int, which: int) -> Tensor:
    """Where an arm's tool is in the world, by yourdfpy's own kinematics of all joints."""
    robot = opened()[0].domain.robot
    model, words = robot.urdf.model, robot.description
    joints = dict(zip(joint_names(robot), one.joints[frame].tolist(), strict=True))
    model.update_cfg({words.torso_joint: words.torso_position, **joints})
    at = torch.tensor(model.get_transform(words.arms[which].tool_frame, words.base_frame)[:3, 3])
    x, y, turn = one.pose[frame].double()
    return torch.cat([rotate(at[:2], turn) + torch.stack([x, y]), at[2:]])


@pytest.mark.parametrize("number", range(COUNT))
def test_the_arm_really_reaches_and_lifts_the_object(number: int) -> None:
    one = timeline(number)
    assert one.execution.end == "success"
    moved = (one.object[:, 2] > one.object[0, 2] + 1e-4).nonzero()[:, 0]
    up = torch.tensor([0.0, 0.0, GRASP_HEIGHT])
    first = one.start_of(len(one.execution.steps) - 1)
    assert torch.equal(one.joints[first], one.joints[0])  # at home, where the arm's way begins
    for frame in (int(moved[0]) - 1, int(moved[len(moved) // 2]), len(one) - 1):
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
    table = torch.cat([seen, scene.table[0, 5:].double().expand(len(pose), 1)], 1)
    places, kind = places_of(table[:, :3], table), torch.full((len(pose),), POSTURE)
    parts = joints.split([len(arm.joint_names) for arm in robot.arms], 1)
    for arm, scene_of, mine in zip(robot.arms, robot.scenes, parts, strict=True):
        # Positions are rounded, and ways keep 2 mm.
        with patch.object(clear_ways, "MARGIN", 0.0015):
            assert clear_ways.ways_clear(arm, scene_of, places, kind, mine[:, None]).all()


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


def test_a_grasp_is_seen_as_it_is_simulated() -> None:
    """The arm leaves home, fingers close on the object, nothing else is met, and it is lifted."""
    one, robot = simulated(), opened()[0].domain.robot
    arms = len(joint_names(robot))
    fingers = one.joints[:, arms:]
    assert fingers.shape[1] == len(robot.arms)
    assert float((fingers[0] - fingers[-1]).max()) > 0.05
    assert float(one.joints[:, :arms].diff(dim=0).abs().max()) <= 3.0 / FPS
    assert float(one.object[-1, 2] - one.object[0, 2]) > LIFTED
    touched = torch.cat(one.contacts)
    assert len(touched)
    assert not touched[:, 3].any()
    assert float(touched[:, 2].min()) > 0.7


def seen(what: str, *goals: list[float]) -> tuple[Tensor, list[Tensor]]:
    """The pictures of one step that asks physics for motions or grasps, and their contacts."""
    robot = opened()[0].domain.robot
    recorder = Recorder(robot)
    physics = Physics(robot, watch=recorder)
    for goal in goals:
        (drives if what == "drive" else grasps)(physics, torch.tensor([[*SCENE, *goal]]))
    recorder.end_step()
    recorder.end_step()
    pictures, nothing = recorder.steps
    assert nothing == [], "a step without a simulation has no pictures"
    return torch.stack([row for row, _ in pictures]), [points for _, points in pictures]


def test_an_object_that_is_pushed_falls_over() -> None:
    """It is seen four centimetres beside where it is, so a finger comes down on it."""
    rows, _ = seen("grasp", [0.65, 0.1 - 0.04, 0.79])
    thing, turned = rows[:, 3:6], rows[:, 6:10]
    assert len(rows) > 5 * FPS
    assert torch.allclose(turned.norm(dim=1), torch.ones(len(rows)).double(), atol=1e-6)
    assert float((thing - thing[:1]).norm(dim=1).max()) > 0.03
    half_turn = (turned[:1] * turned).sum(1).abs().clamp(max=1).arccos()
    assert 2 * float(half_turn.max()) > 1.0  # rad
    assert thing[0].tolist() == pytest.approx([-0.3, 0.1, 0.74], abs=1e-3)


def test_a_base_that_bumps_is_marked() -> None:
    """It is sent through the table's block."""
    rows, contacts = seen("drive", [0.0, 0.0, 0.0])
    assert torch.cat(contacts)[:, 3].any()
    assert float(rows[-1, 0]) < -0.5


def test_an_action_that_drives_twice_has_all_pictures() -> None:
    once, twice = [-0.85, 0.0, 0.0], [-1.05, 0.0, 0.0]
    assert len(seen("drive", once, twice)[0]) > 1.5 * len(seen("drive", once)[0])


def test_a_line_ends_in_its_end_and_begins_after_its_start() -> None:
    assert [_count(seconds) for seconds in (0.0, 0.12, 1.0)] == [1, round(0.12 * FPS), FPS]
    start, end = torch.tensor([1.0, 0.0]), torch.tensor([3.0, -4.0])
    assert _line(start, end, 4 / FPS).tolist() == [[1.5, -1], [2, -2], [2.5, -3], [3, -4]]
    here = torch.tensor([1.0, 2.0, 3.0])
    assert _drive(here, here).tolist() == [[1, 2, 3]]
    turned = _drive(here, torch.tensor([1.0, 2.0, 3.0 - TURN]))
    assert len(turned) == 1 + FPS
    assert turned[-1].tolist() == pytest.approx([1, 2, 3 - TURN])
    there = _drive(here, torch.tensor([1.0 + DRIVE, 2.0, 3.0 + 2 * pi]))
    assert len(there) == FPS + 1
    assert there[0].tolist() == pytest.approx([1 + DRIVE / FPS, 2, 3])


def test_what_moves_nothing_lasts_as_long_as_it_takes_to_look_or_to_think() -> None:
    assert [seconds_of(action) for action in (Detect(), Grasp(), Step(3))] == [LOOK, LOOK, THINK]


def test_the_last_picture_is_shown_for_a_while() -> None:
    pieces = [torch.arange(11.0).expand(2, 11), torch.ones(3, 11)]
    touched = torch.tensor([[1.0, 2.0, 3.0, 0.0]])
    line = laid_out(SimpleNamespace(), ("a",), pieces, [touched])  # type: ignore[arg-type]
    assert len(line) == 5 + round(REST * FPS)
    assert line.step.tolist() == [0, 0, *[1] * (3 + round(REST * FPS))]
    assert line.seen.tolist() == [0, 1, 1, 1, *[2] * (1 + round(REST * FPS))]
    assert (line.pose[0].tolist(), line.object[0].tolist()) == ([0, 1, 2], [3, 4, 5])
    assert (line.turned[0].tolist(), line.joints[0].tolist()) == ([6, 7, 8, 9], [10])
    assert line.pose[-1].tolist() == [1, 1, 1]
    assert [len(points) for points in line.contacts] == [1, *[0] * (len(line) - 1)]


@pytest.mark.parametrize(
    ("quaternion", "up"),
    [
        ([1, 0, 0, 0], [0, 0, 1]), ([0.5**0.5, 0.5**0.5, 0, 0], [0, -1, 0]),
        ([0.5**0.5, 0, 0.5**0.5, 0], [1, 0, 0]), ([0.5**0.5, 0, 0, 0.5**0.5], [0, 0, 1]),
        ([0.5, 0.5, 0.5, 0.5], [1, 0, 0]), ([0.5, -0.5, 0.5, 0.5], [0, 1, 0]),
    ],
)  # fmt: skip
def test_upwards_is_where_a_turned_object_s_axis_leads(
    quaternion: list[float], up: list[float]
) -> None:
    assert _upwards(torch.tensor(quaternion)).tolist() == pytest.approx(up, abs=1e-6)


@pytest.mark.parametrize("arm", [True, False])
def test_contacts_are_wrong_where_the_arm_touches_or_the_base_bumps(arm: bool) -> None:
    """Geoms are floor, arm, object and table."""
    touching, bumping = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    touching[1, 3], bumping[1, 2], bumping[1, 3] = True, True, True
    contact = SimpleNamespace(
        geom=np.array([[1, 3], [1, 2], [0, 2], [1, 3]]), dist=np.array([-0.1, -0.1, -0.1, 0.0]),
        pos=np.arange(12.0).reshape(4, 3),
    )  # fmt: skip
    parts: dict[str, Any] = {"touching": touching, "bumping": bumping, "arm": ("a",) if arm else ()}
    model: Any = SimpleNamespace(data=SimpleNamespace(contact=contact), **parts)
    assert contacts_of(model).tolist() == [[0, 1, 2, 1], [3, 4, 5, 0 if arm else 1]]
    contact.dist = np.zeros(0)
    assert contacts_of(model).shape == (0, 4)


def test_pictures_are_taken_at_equal_times_of_each_simulation() -> None:
    recorder = Recorder(opened()[0].domain.robot)

    def taken(model: Any) -> float:
        return float(model.data.time)

    with patch.object(recorder, "_seen", taken):
        for seconds in (0.0, 0.3 / FPS, 1 / FPS, 1.1 / FPS, 2 / FPS, 0.0, 1 / FPS, 1.5 / FPS):
            recorder(SimpleNamespace(data=SimpleNamespace(time=seconds)))  # type: ignore[arg-type]
        recorder.end_step()
        recorder.end_step()
        recorder(SimpleNamespace(data=SimpleNamespace(time=0.0)))  # type: ignore[arg-type]
        recorder.end_step()
    ticks: list[Any] = [0.0, 1 / FPS, 2 / FPS, 0.0, 1 / FPS, 1.5 / FPS]
    assert recorder.steps == [ticks, [], [0.0, 0.0]]


def test_an_object_is_seen_during_a_step_where_it_was_before() -> None:
    run, _ = opened()
    scenarios = draw_of("far")(1, torch.Generator().manual_seed(1))
    failed = execute(grasping_on_and_on(), run.domain.world(scenarios), 0)
    assert len(failed.steps) > 1
    pushed = failed.object + torch.arange(len(failed.object))[:, None]
    one = timeline_of(replace(failed, object=pushed), run.domain.robot)
    for k in range(len(failed.steps)):
        there = one.object[one.step == k]
        assert torch.equal(there, pushed[k].float().expand_as(there))
