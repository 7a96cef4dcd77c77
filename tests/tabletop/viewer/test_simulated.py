"""What the view shows of physics is what was simulated."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

pytest.importorskip("mujoco")

from cgtorch.runs.skills import last_skill
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import Robot, load_robot
from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.grasp import LIFTED
from cgtorch.tabletop.physics.world import drives, grasps
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.viewer.simulated import Recorder, simulated_timeline
from cgtorch.tabletop.viewer.timeline import FPS, Moves, Timeline
from cgtorch.tabletop.world import draw_of
from cgtorch.tabletop.world.geometry import wrap

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
SCENE = [-0.95, 0.0, 0.0, 0, 0, 0, 0.8, 1.2, 0.74, -0.3, 0.1, 0.79, 1, 0, 0, 0]


@cache
def robot() -> Robot:
    return load_robot()


@cache
def timeline() -> Timeline:
    run, skill = last_skill(REFERENCE)
    domain = run.domain.in_world("mujoco")
    assert isinstance(domain, Tabletop)
    scenario = draw_of("perimeter")(3, torch.Generator().manual_seed(4))[torch.tensor([1])]
    one = simulated_timeline(skill, domain, scenario)
    usual = execute(skill, domain.world(scenario))
    assert one.execution.end == usual.end == "success"
    assert torch.equal(one.execution.pose, usual.pose), "being watched changes nothing"
    return one


def seen(row: list[float], what: str) -> Moves:
    """The pictures of one answer of physics."""
    recorder = Recorder(robot())
    physics = Physics(robot(), watch=recorder)
    (drives if what == "drive" else grasps)(physics, torch.tensor([row]))
    recorder.end_step()
    (moves,) = recorder.steps
    assert moves is not None
    return moves


def test_every_step_ends_where_the_world_says() -> None:
    one = timeline()
    run = one.execution
    lengths = {len(x) for x in (one.pose, one.joints, one.object, one.turned, one.contacts)}
    assert lengths == {len(one)} == {len(one.seen)}
    for k in range(len(run.steps)):
        frames = (one.step == k).nonzero()[:, 0]
        away = one.pose[int(frames[-1])] - run.pose[k + 1]
        if run.steps[k].name != "Grasp":  # in which the base gives way a little
            assert float(away[:2].norm() + wrap(away[2:]).abs()) < 1e-5
        assert int(one.seen[int(frames[-1])]) == k + 1
    assert (one.step[1:] >= one.step[:-1]).all()


def test_a_grasp_is_seen_as_it_is_simulated() -> None:
    """The arm leaves home, fingers close on the object, nothing else is met, and it is lifted."""
    one = timeline()
    arms = sum(len(arm.joint_names) for arm in robot().arms)
    fingers = one.joints[:, arms:]
    assert fingers.shape[1] == len(robot().arms)
    assert float((fingers[0] - fingers[-1]).max()) > 0.05
    moved = (one.joints[1:, :arms] - one.joints[:-1, :arms]).abs()
    assert float(moved.max()) <= 3.0 / FPS
    assert float(one.object[-1, 2] - one.object[0, 2]) > LIFTED
    touched = [points for points in one.contacts if len(points)]
    assert touched
    assert not any(bool(points[:, 3].any()) for points in touched)
    assert all(float(points[:, 2].min()) > 0.7 for points in touched)


def test_an_object_that_is_pushed_falls_over() -> None:
    """It is seen four centimetres beside where it is, so a finger comes down on it."""
    moves = seen([*SCENE, 0.65, 0.1 - 0.04, 0.79], "grasp")
    assert len(moves) > 5 * FPS
    assert torch.allclose(moves.turned.norm(dim=1), torch.ones(len(moves)).double(), atol=1e-6)
    away = (moves.object - moves.object[:1]).norm(dim=1)
    assert float(away.max()) > 0.03
    half_turn = (moves.turned[:1] * moves.turned).sum(1).abs().clamp(max=1).arccos()
    assert 2 * float(half_turn.max()) > 1.0  # rad
    assert moves.object[0].tolist() == pytest.approx([-0.3, 0.1, 0.74], abs=1e-3)


def test_a_base_that_bumps_is_marked() -> None:
    """It is sent through the table's block."""
    moves = seen([*SCENE, 0.0, 0.0, 0.0], "drive")
    assert bool(moves.contacts[-1][:, 3].all()) or any(bool(p[:, 3].any()) for p in moves.contacts)
    assert float(moves.pose[-1, 0]) < -0.5


def test_an_action_that_drives_twice_has_all_pictures() -> None:
    recorder = Recorder(robot())
    physics = Physics(robot(), watch=recorder)
    for x in (-0.85, -1.05):
        drives(physics, torch.tensor([[*SCENE, x, 0.0, 0.0]]))
    recorder.end_step()
    (both,) = recorder.steps
    single = seen([*SCENE, -0.85, 0.0, 0.0], "drive")
    assert both is not None
    assert len(both) > 1.5 * len(single)


def test_a_step_without_a_simulation_has_no_pictures() -> None:
    recorder = Recorder(robot())
    recorder.end_step()
    assert recorder.steps == [None]
    assert replace(Physics(robot()), watch=recorder).watch is recorder
