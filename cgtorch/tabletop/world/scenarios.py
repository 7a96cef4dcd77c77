"""Scenarios: a robot in front of a table with an object near an edge.

Those of section VI have the paper's table; others have any size, height and yaw, with the robot on
any side, and obstacles.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from cgtorch.ground.environment import ScenarioBatch
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.world.geometry import rectangles_overlap, rotate

TABLE_DEPTH, TABLE_WIDTH, TABLE_HEIGHT = 0.8, 1.2, 0.74
START_DISTANCE, START_SPREAD, START_SIDEWAYS = 1.0, 0.2, 0.2
START_HEADING = torch.pi / 36  # 5°
INSET_MIN, INSET_MAX = 0.05, 0.15
EDGES = ("near", "left", "right", "far")
PLACEMENTS = (*EDGES, "perimeter")

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


@dataclass(frozen=True)
class Scenarios(ScenarioBatch):
    """B initial states of the world.

    The world's origin is the table's centre in the paper's experiments. x points away from the
    robot, so the near edge is at -x and the left edge at +y.

    Attributes:
        pose: (B, 3) base x, y (m), θ (rad).
        table: (B, 6) centre x, centre y (m), yaw (rad), size x, size y, top height (m).
        object: (B, 2) x, y (m); it is on the table.
        seed: (B,) long, of the robot's noise. Noise is part of the scenario: the same skill on the
            same scenario gives the same result.
        obstacles: (B, K, 5) centre x, centre y (m), yaw (rad), size x, size y of boxes on the
            floor, low enough to reach over; one of size 0 is absent. K = 0 by default.
    """

    pose: Tensor
    table: Tensor
    object: Tensor
    seed: Tensor
    obstacles: Tensor = field(default_factory=lambda: torch.empty(0, 0, 5))

    def __post_init__(self) -> None:
        """Add the default of no obstacles."""
        if self.obstacles.shape[1] == 0:
            object.__setattr__(self, "obstacles", self.pose.new_zeros(len(self.pose), 0, 5))

    def joined(self, *more: "Scenarios") -> "Scenarios":
        """These scenarios, followed by more; those with fewer obstacles get some of size 0."""
        most = max(s.obstacles.shape[1] for s in (self, *more))
        padded = [
            replace(s, obstacles=pad(s.obstacles, (0, 0, 0, most - s.obstacles.shape[1])))
            for s in (self, *more)
        ]
        return ScenarioBatch.joined(*padded)

    def with_noise(self, copy: int) -> "Scenarios":
        """The same initial states with other noise; copy 0 is unchanged."""
        return replace(self, seed=(self.seed + copy * 0x9E3779B1) % 2**31)


def _table(n: int) -> Tensor:
    return torch.tensor([0.0, 0, 0, TABLE_DEPTH, TABLE_WIDTH, TABLE_HEIGHT]).repeat(n, 1)


def _on_edge(edge: Tensor, along: Tensor, inset: Tensor) -> Tensor:
    """Objects (n, 2) on edges (n,), `along` in [-1, 1] of the usable length, `inset` m inwards."""
    hx, hy = TABLE_DEPTH / 2, TABLE_WIDTH / 2
    x_along, y_along = along * (hx - INSET_MIN), along * (hy - INSET_MIN)
    x = torch.stack([inset - hx, x_along, x_along, hx - inset], 1)
    y = torch.stack([y_along, hy - inset, inset - hy, y_along], 1)
    pick = edge[:, None]
    return torch.cat([x.gather(1, pick), y.gather(1, pick)], 1)


def check_known(what: str, name: str, known: Collection[str]) -> None:
    """SettingsError if a name is not among the known ones."""
    if name not in known:
        raise SettingsError(f"unknown {what} {name!r}; use one of {', '.join(known)}")


def check_count(count: int) -> None:
    """SettingsError if the count is negative."""
    if count < 0:
        raise SettingsError(f"count is {count}; give 0 or more scenarios")


def stage_scenarios(edge: str, count: int = 5) -> Scenarios:
    """The paper's test of one edge: evenly spaced objects, from the centred start.

    The first and last are in the corners, 0.05 m from the adjoining edge. SettingsError if the edge
    is not in `EDGES`, or the count is negative.
    """
    check_count(count)
    check_known("table edge", edge, EDGES)
    along = torch.linspace(-1, 1, count)
    inset = torch.full((count,), (INSET_MIN + INSET_MAX) / 2)
    placed = _on_edge(torch.full((count,), EDGES.index(edge)), along, inset)
    pose = torch.tensor([-TABLE_DEPTH / 2 - START_DISTANCE, 0.0, 0.0]).repeat(count, 1)
    return Scenarios(pose, _table(count), placed, torch.arange(count))


def random_scenarios(placement: str, count: int, generator: Generator) -> Scenarios:
    """Random objects along one edge or, with "perimeter", along all four.

    SettingsError if the placement is not in `PLACEMENTS`, or the count is negative.
    """
    check_count(count)
    check_known("placement", placement, PLACEMENTS)
    draw = torch.rand(count, 6, generator=generator)
    spread = 2 * draw - 1
    if placement == "perimeter":
        lengths = torch.tensor([TABLE_WIDTH, TABLE_DEPTH, TABLE_DEPTH, TABLE_WIDTH])
        bounds = torch.cumsum(lengths, 0) / lengths.sum()
        edge = torch.searchsorted(bounds, draw[:, 5].contiguous()).clamp_max(3)
    else:
        edge = torch.full((count,), EDGES.index(placement))
    inset = INSET_MIN + (INSET_MAX - INSET_MIN) * draw[:, 1]
    distance = START_DISTANCE + START_SPREAD * spread[:, 2]
    sideways, heading = START_SIDEWAYS * spread[:, 3], START_HEADING * spread[:, 4]
    pose = torch.stack([-TABLE_DEPTH / 2 - distance, sideways, heading], 1)
    seed = torch.randint(2**31, (count,), generator=generator)
    return Scenarios(pose, _table(count), _on_edge(edge, spread[:, 0], inset), seed)


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
    out, length = half - inset[:, None], (half - CORNER) * along[:, None]
    out = torch.where((part < 0.5)[:, None], -out, out)
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
    gap = (at.abs() - obstacle[:, 3:] / 2).clamp_min(0).norm(dim=1)
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
