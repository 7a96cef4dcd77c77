"""Where the robot is put to collect data: free poses around the table and around the object."""

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.world import Scenarios, TabletopWorld, concatenate_scenarios, random_scenarios
from cgtorch.world.geometry import rectangle_in_frame, rotate, sweep_blocked

ARENA = 2.2  # m from the table's centre within which the robot is driven
REACH = (0.3, 1.3)  # m between base and object where a grasp may be possible or not

WorldOf: TypeAlias = Callable[[Scenarios], TabletopWorld]


def poses_around(
    world_of: WorldOf, count: int, generator: Generator, arena: float = ARENA
) -> Scenarios:
    """Scenarios with the robot at a random free pose anywhere around the table.

    Positions are uniform within `arena` m of the table's centre along x and along y.
    """

    def draw(n: int) -> Scenarios:
        base = random_scenarios("perimeter", n, generator)
        pose = 2 * torch.rand(n, 3, generator=generator) - 1
        pose = pose * torch.tensor([arena, arena, torch.pi])
        return Scenarios(pose, base.table, base.object, base.seed)

    return _resample(count, draw, world_of)


def poses_at_object(world_of: WorldOf, count: int, generator: Generator) -> Scenarios:
    """Scenarios with the robot free within or just out of reach of the object.

    Distance, side and heading are uniform; objects stand along all edges.
    """

    def draw(n: int) -> Scenarios:
        base = random_scenarios("perimeter", n, generator)
        part = torch.rand(n, 3, generator=generator)
        distance = REACH[0] + (REACH[1] - REACH[0]) * part[:, 0]
        bearing, heading = (torch.pi * (2 * part[:, 1:] - 1)).unbind(1)
        offset = rotate(torch.stack([distance, torch.zeros_like(distance)], 1), bearing)
        pose = torch.cat([base.object + offset, heading[:, None]], 1)
        return Scenarios(pose, base.table, base.object, base.seed)

    return _resample(count, draw, world_of)


def in_table(scenarios: Scenarios, footprint: Tensor) -> Tensor:
    """(B,) bool, whether the base would stand in the table."""
    table = rectangle_in_frame(scenarios.pose, scenarios.table[:, :5])
    return sweep_blocked(torch.zeros_like(scenarios.pose), table, footprint)


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
