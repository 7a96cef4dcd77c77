"""Scenarios that can be solved, by the robots' own arms."""

from functools import partial

import pytest
import solvable_scenes
import torch
from click.testing import CliRunner
from shapely import Polygon
from solvability.poses import pose_that_grasps, standing_free
from solvability.ways import fewest_moves
from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot, graspable, load_robot
from cgtorch.tabletop.world import Scenarios, TabletopWorld, draw_of, random_scenarios
from cgtorch.tabletop.world.clear_motion import CLEARANCE
from cgtorch.tabletop.world.geometry import box_rectangle, corners, rectangle_in_frame, to_frame


@pytest.fixture(scope="module", params=["pr2", "fetch"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(description=request.param)


@pytest.mark.parametrize("kind", ["general", "general-clutter"])
def test_a_free_pose_solves_each(robot: Robot, kind: str) -> None:
    scenes = draw_of(kind)(60, seeded(0))
    footprint = robot.description.footprint

    def world_of(scenarios: Scenarios) -> TabletopWorld:
        return TabletopWorld(scenarios, partial(graspable, robot), footprint)

    found, pose = pose_that_grasps(world_of, scenes, seeded(1), rounds=128)
    assert found.all()
    table = torch.cat([rectangle_in_frame(pose, scenes.table[:, :5]), scenes.table[:, 5:]], 1)
    at = torch.cat([to_frame(pose, scenes.object), scenes.table[:, 5:]], 1)
    assert graspable(robot, at, table).all()
    wide = torch.tensor(footprint) + CLEARANCE * torch.tensor([-1, 1, -1, 1])
    base = Polygon(corners(box_rectangle(wide)).tolist())
    things = torch.cat([table[:, None, :5], rectangle_in_frame(pose[:, None], scenes.obstacles)], 1)
    for row in corners(things).tolist():
        for shape in map(Polygon, row):
            assert shape.area < 1e-9 or shape.intersection(base).area < 1e-6


def test_what_nobody_can_grasp_is_not_solvable() -> None:
    def nobody(at: Tensor, table: Tensor) -> Tensor:
        return torch.zeros(len(at), dtype=torch.bool)

    scenes = random_scenarios("near", 5, seeded(0))
    found, pose = pose_that_grasps(
        lambda s: TabletopWorld(s, nobody, FOOTPRINT), scenes, seeded(1), rounds=2
    )
    assert not found.any()
    assert torch.equal(pose, scenes.pose)


@pytest.mark.parametrize("kind", ["perimeter", "general", "general-clutter"])
def test_robots_start_free(kind: str) -> None:
    assert standing_free(draw_of(kind)(500, seeded(2)), torch.tensor(FOOTPRINT)).all()


def scene(obstacles: list[list[float]]) -> Scenarios:
    """One table, the robot 1.4 m before its middle, an object on the far side."""
    return Scenarios(
        torch.tensor([[-1.4, 0, 0]]),
        torch.tensor([[0, 0, 0, 0.8, 1.2, 0.74]]),
        torch.tensor([[0.3, 0.0]]),
        torch.tensor([0]),
        torch.tensor([obstacles]),
    )


@pytest.mark.parametrize(
    ("goal", "least"), [([-0.8, 0.0, 0.0], 1), ([0.9, 0.0, 3.1416], 2), ([0.0, 0.0, 0.0], 0)]
)
def test_ways_are_counted_in_moves(goal: list[float], least: int) -> None:
    """Straight ahead, round the table, and into the table, which nobody can."""
    moves = fewest_moves(
        scene([[0, 0, 0, 0, 0]]), torch.tensor(FOOTPRINT), torch.tensor([goal]), 300, 8, seeded(0)
    )
    assert moves >= least
    assert (moves == least) or least == 2


def test_walls_shut_the_robot_in() -> None:
    walls = [[-1.4, y, 0, 2, 0.1] for y in (-0.6, 0.6)]
    walls += [[x, 0, 0, 0.1, 1.1] for x in (-2.1, -0.7)]
    goal, footprint = torch.tensor([[0.9, 0.0, 3.1416]]), torch.tensor(FOOTPRINT)
    for shut, those in ((True, walls), (False, walls[:2])):
        assert (fewest_moves(scene(those), footprint, goal, 300, 8, seeded(0)) == 0) is shut


def test_the_command_prints_the_share() -> None:
    ended = CliRunner().invoke(solvable_scenes.command, ["--count", "6", "--samples", "60"])
    assert ended.exit_code == 0, ended.output
    assert "6 of 6 scenes have a pose that grasps" in ended.output
    assert "can be solved" in ended.output
