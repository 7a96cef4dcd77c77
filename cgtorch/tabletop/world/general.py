"""Scenarios beyond the paper's table: any size, height and yaw, any side, with obstacles."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.world.geometry import rectangles_overlap, rotate
from cgtorch.tabletop.world.scenarios import (
    PLACEMENTS,
    Scenarios,
    check_count,
    check_known,
    random_scenarios,
)

SIDE = (0.6, 1.4)  # m
HEIGHT = (0.6, 0.9)  # m
INSET = (0.05, 0.25)  # m between the object and its edge
CORNER = 0.05  # m that the object keeps from the adjoining edges
AWAY = (1.0, 2.5)  # m between the base's centre and the table
VIEW = math.pi / 4  # rad to either side in which the table's centre lies at the start
OBSTACLE_SIDE = (0.3, 0.6)  # m
OBSTACLE_AWAY = (0.0, 1.5)  # m between the obstacle's centre and the table's edge
OBSTACLE_SHARE = 0.5  # of the scenarios
ROOM = 0.55  # m around the robot's start that is free, so that it can turn there


def general_scenarios(count: int, generator: Generator) -> Scenarios:
    """Random tables, 0.6 to 1.4 m a side and 0.6 to 0.9 m high, with the robot on any side.

    The table's centre is the origin. The object is 0.05 to 0.25 m from an edge, which is drawn by
    its length. The robot is 1 to 2.5 m away from the table in any direction, and its heading is
    such that the table's centre is within 45° of straight ahead. Everything else is uniform.
    SettingsError if the count is negative.
    """
    check_count(count)
    draw = torch.rand(count, 10, generator=generator)
    sides, height = _between(SIDE, draw[:, 0:2]), _between(HEIGHT, draw[:, 2:3])
    yaw, direction = (math.pi * (2 * draw[:, 3:5] - 1)).unbind(1)
    inset, along = _between(INSET, draw[:, 5]), 2 * draw[:, 6] - 1
    placed = rotate(_along_an_edge(sides, draw[:, 7], along, inset), yaw)
    start = rotate(beside(direction, sides / 2, _between(AWAY, draw[:, 8])), yaw)
    to_table = torch.atan2(-start[:, 1], -start[:, 0])
    heading = to_table + VIEW * (2 * draw[:, 9] - 1)
    pose = torch.cat([start, heading[:, None]], 1)
    table = torch.cat([torch.zeros(count, 2), yaw[:, None], sides, height], 1)
    seed = torch.randint(2**31, (count,), generator=generator)
    return Scenarios(pose, table, placed, seed)


def cluttered_scenarios(count: int, generator: Generator) -> Scenarios:
    """`general_scenarios`, half of them with a box on the floor, 0.3 to 0.6 m a side.

    The box is in any direction from the table, with its centre up to 1.5 m away from the edge. It
    overlaps neither the table nor the area that the robot needs to turn at its start. SettingsError
    if the count is negative.
    """
    scenes = general_scenarios(count, generator)
    has_one = torch.rand(count, generator=generator) < OBSTACLE_SHARE
    obstacle = torch.zeros(count, 5)
    wanted = has_one.nonzero()[:, 0]
    while len(wanted):
        drawn = _obstacles(scenes[wanted], generator)
        fits = ~_in_the_way(drawn, scenes[wanted])
        obstacle[wanted[fits]] = drawn[fits]
        wanted = wanted[~fits]
    return replace(scenes, obstacles=obstacle[:, None])


def _between(bounds: tuple[float, float], share: Tensor) -> Tensor:
    return bounds[0] + (bounds[1] - bounds[0]) * share


def _along_an_edge(sides: Tensor, pick: Tensor, along: Tensor, inset: Tensor) -> Tensor:
    """Objects (n, 2) in the frame of tables with sides (n, 2), `inset` (n,) m from an edge.

    `pick` (n,) in [0, 1) selects the edge: both of length size y, then both of length size x.
    `along` (n,) in [-1, 1] is the place on its usable length.
    """
    half = sides / 2
    share = sides[:, 1] / sides.sum(1)  # of the perimeter, that the edges across x have
    across_x = pick < share
    part = torch.where(across_x, pick / share, (pick - share) / (1 - share))
    sign = torch.where(part < 0.5, -1.0, 1.0)
    out, length = (half - inset[:, None]) * sign[:, None], (half - CORNER) * along[:, None]
    x_edge = torch.stack([out[:, 0], length[:, 1]], 1)
    y_edge = torch.stack([length[:, 0], out[:, 1]], 1)
    return torch.where(across_x[:, None], x_edge, y_edge)


def beside(direction: Tensor, half: Tensor, distance: Tensor) -> Tensor:
    """Points (n, 2) in directions (n,) at distances (n,) from centred boxes of half sizes (n, 2).

    The nearest point of a box is on its side across x, on the one across y, or its corner.
    """
    ray = torch.stack([direction.cos(), direction.sin()], 1)
    steep = ray.abs().clamp_min(1e-9)
    to_sides = (half + distance[:, None]) / steep
    along = (steep * half).sum(1)
    reach = (along.square() - half.square().sum(1) + distance.square()).clamp_min(0)
    radius = along + reach.sqrt()
    for axis in (0, 1):
        beside_it = to_sides[:, axis] * steep[:, 1 - axis] <= half[:, 1 - axis]
        radius = torch.where(beside_it, to_sides[:, axis], radius)
    return radius[:, None] * ray


def _obstacles(scenes: Scenarios, generator: Generator) -> Tensor:
    """(n, 5) boxes around the table, at any place."""
    draw = torch.rand(len(scenes), 5, generator=generator)
    sides, away = _between(OBSTACLE_SIDE, draw[:, 0:2]), _between(OBSTACLE_AWAY, draw[:, 2])
    direction, yaw = (math.pi * (2 * draw[:, 3:5] - 1)).unbind(1)
    table_yaw = scenes.table[:, 2]
    centre = rotate(beside(direction, scenes.table[:, 3:5] / 2, away), table_yaw)
    return torch.cat([centre, yaw[:, None], sides], 1)


def _in_the_way(obstacle: Tensor, scenes: Scenarios) -> Tensor:
    """(n,) bool, whether boxes (n, 5) overlap the table or are too close to the robot."""
    at = rotate(scenes.pose[:, :2] - obstacle[:, :2], -obstacle[:, 2])
    gap = (at.abs() - obstacle[:, 3:5] / 2).clamp_min(0).norm(dim=1)
    return rectangles_overlap(obstacle, scenes.table[:, :5]) | (gap < ROOM)


Draw: TypeAlias = Callable[[int, Generator], Scenarios]
"""Maps the number of scenarios and the generator of all random choices to scenarios."""

DRAWS: dict[str, Draw] = {
    **{placement: partial(random_scenarios, placement) for placement in PLACEMENTS},
    "general": general_scenarios,
    "general-clutter": cluttered_scenarios,
}


def draw_of(name: str) -> Draw:
    """The function that draws the scenarios called `name`; SettingsError for an unknown name."""
    check_known("placement", name, DRAWS)
    return DRAWS[name]
