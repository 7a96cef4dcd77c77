"""Scenarios that can be solved, by the robots' own arms."""

from functools import partial

import pytest
import torch
from shapely import Polygon
from solvable import pose_that_grasps, standing_free
from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot, graspable, load_robot
from cgtorch.tabletop.world import Scenarios, TabletopWorld, draw_of, random_scenarios
from cgtorch.tabletop.world.clear_way import CLEARANCE
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
