"""Poses of the base that solve scenarios: free ones from which a grasp succeeds."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import start_lanes
from cgtorch.tabletop.world import TabletopWorld
from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import rectangle_in_frame, rotate
from cgtorch.tabletop.world.scenarios import Scenarios

DISTANCE = (0.4, 0.9)  # m between base and object
TURNED = math.pi / 3  # rad to either side of facing the object
TRIES = 16  # poses for each scenario in one round


def pose_that_grasps(
    world_of: Callable[[Scenarios], TabletopWorld],
    scenarios: Scenarios,
    generator: Generator,
    rounds: int = 32,
) -> tuple[Tensor, Tensor]:
    """Look for poses of the base that solve scenarios, by drawing them.

    Poses are drawn 0.4 to 0.9 m from the object on any side, facing it within 60°. One counts if
    the base keeps its clearance to the table and all obstacles there and a grasp succeeds.

    Args:
        world_of: makes the world of given scenarios.
        scenarios: B of them.
        generator: of the poses.
        rounds: at most, of 16 poses for each scenario that is still open.

    Returns:
        (B,) bool, whether a pose was found, and such poses (B, 3); elsewhere the start.
    """
    found = torch.zeros(len(scenarios), dtype=torch.bool)
    pose = scenarios.pose.clone()
    for _ in range(rounds):
        still = (~found).nonzero()[:, 0]
        if not len(still):
            break
        good, tried = poses_that_grasp(world_of, scenarios[still], generator)
        which = good.long().argmax(1)
        solved = good.any(1)
        found[still[solved]] = True
        pose[still[solved]] = tried[torch.arange(len(still)), which][solved]
    return found, pose


def poses_that_grasp(
    world_of: Callable[[Scenarios], TabletopWorld],
    scenarios: Scenarios,
    generator: Generator,
) -> tuple[Tensor, Tensor]:
    """One round of `pose_that_grasps`: (B, 16) bool, and the poses (B, 16, 3) that were drawn."""
    footprint = world_of(scenarios[:0]).footprint
    row = torch.arange(len(scenarios)).repeat_interleave(TRIES)
    tried = _poses(scenarios[row], generator)
    there = replace(scenarios[row], pose=tried)
    good = standing_free(there, footprint)
    good[good.clone()] = _grasps(world_of(there[good]))
    return good.view(-1, TRIES), tried.view(-1, TRIES, 3)


def standing_free(scenarios: Scenarios, footprint: Tensor) -> Tensor:
    """(B,) bool, whether the base keeps its clearance to the table and all obstacles."""
    things = torch.cat([scenarios.table[:, None, :5], scenarios.obstacles], 1)
    here = rectangle_in_frame(scenarios.pose[:, None], things)
    return motion_possible(torch.zeros_like(scenarios.pose), here, footprint)


def _poses(scenarios: Scenarios, generator: Generator) -> Tensor:
    """(B, 3) around the objects."""
    draw = torch.rand(len(scenarios), 3, generator=generator)
    distance = DISTANCE[0] + (DISTANCE[1] - DISTANCE[0]) * draw[:, 0]
    bearing, turn = 2 * math.pi * draw[:, 1], TURNED * (2 * draw[:, 2] - 1)
    place = scenarios.object + rotate(torch.stack([distance, 0 * distance], 1), bearing)
    return torch.cat([place, (bearing + math.pi + turn)[:, None]], 1)


def _grasps(world: TabletopWorld) -> Tensor:
    """(B,) bool, whether a grasp succeeds from where the robot starts."""
    return world.success(start_lanes(world, torch.arange(world.num_scenarios), 0, 0))[1] > 0.5
