"""Where the robot is put to collect data: free poses around the table and around the object."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.world import (
    PLACEMENTS,
    Scenarios,
    TabletopWorld,
    concatenate_scenarios,
    draw_of,
)
from cgtorch.tabletop.world.draws import Draw
from cgtorch.tabletop.world.geometry import rectangle_in_frame, rotate
from cgtorch.tabletop.world.percepts import present
from cgtorch.tabletop.world.sweep import sweep_blocked

ARENA = 2.2  # m from the table's centre within which the robot is driven around the paper's
WIDE_ARENA = 3.5  # the same around other tables, from which robots start further away
REACH = (0.3, 1.3)  # m between base and object where a grasp may be possible or not

WorldOf: TypeAlias = Callable[[Scenarios], TabletopWorld]


@dataclass(frozen=True)
class Scenes:
    """The scenes that data are collected in.

    Attributes:
        draw: draws scenarios; the robot's start is not used.
        arena: m from the table's centre within which the robot is driven.
    """

    draw: Draw
    arena: float


PERIMETER = Scenes(draw_of("perimeter"), ARENA)
"""The paper's table, with objects along all edges."""


def scenes_of(name: str) -> Scenes:
    """Where data are collected for scenarios called `name`; all edges for those of one.

    Raises:
        SettingsError: there are no such scenarios.
    """
    draw = draw_of(name)
    return PERIMETER if name in PLACEMENTS else Scenes(draw, WIDE_ARENA)


def poses_around(
    world_of: WorldOf,
    count: int,
    generator: Generator,
    scenes: Scenes = PERIMETER,
    wider: float = 1.0,
) -> Scenarios:
    """Scenarios with the robot at a random free pose anywhere around the table.

    Positions are uniform within the arena of the scenes, `wider` times as large, along x and along
    y.
    """
    arena = wider * scenes.arena

    def draw(n: int) -> Scenarios:
        base = scenes.draw(n, generator)
        pose = 2 * torch.rand(n, 3, generator=generator) - 1
        return replace(base, pose=pose * torch.tensor([arena, arena, torch.pi]))

    return _resample(count, draw, world_of)


def poses_at_object(
    world_of: WorldOf, count: int, generator: Generator, scenes: Scenes = PERIMETER
) -> Scenarios:
    """Scenarios with the robot free within or just out of reach of the object.

    Distance, side and heading are uniform; objects stand along all edges.
    """

    def draw(n: int) -> Scenarios:
        base = scenes.draw(n, generator)
        part = torch.rand(n, 3, generator=generator)
        distance = REACH[0] + (REACH[1] - REACH[0]) * part[:, 0]
        bearing, heading = (torch.pi * (2 * part[:, 1:] - 1)).unbind(1)
        offset = rotate(torch.stack([distance, torch.zeros_like(distance)], 1), bearing)
        pose = torch.cat([base.object + offset, heading[:, None]], 1)
        return replace(base, pose=pose)

    return _resample(count, draw, world_of)


def in_table(scenarios: Scenarios, footprint: Tensor) -> Tensor:
    """(B,) bool, whether the base would stand in the table or in an obstacle."""
    still = torch.zeros_like(scenarios.pose)
    inside = torch.zeros(len(scenarios), dtype=torch.bool)
    for thing in (scenarios.table[:, :5], *scenarios.obstacles.unbind(1)):
        here = rectangle_in_frame(scenarios.pose, thing)
        inside |= present(thing) & sweep_blocked(still, here, footprint)
    return inside


def _resample(count: int, draw: Callable[[int], Scenarios], world_of: WorldOf) -> Scenarios:
    """`count` drawn scenarios in which the base does not stand in the table."""
    parts: list[Scenarios] = []
    have = 0
    while have < count:
        scenarios = draw(2 * (count - have) + 8)
        free = ~in_table(scenarios, world_of(scenarios[:0]).footprint)
        parts.append(scenarios[free.nonzero()[:, 0]])
        have += int(free.sum())
    return concatenate_scenarios(parts)[:count]
