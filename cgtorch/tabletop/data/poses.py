"""Poses of the robot for collecting data: free poses around the table and around the object."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.world import PLACEMENTS, ObservedTabletop, Scenarios, draw_of
from cgtorch.tabletop.world.geometry import rectangle_in_frame, rotate
from cgtorch.tabletop.world.percepts import present
from cgtorch.tabletop.world.sweep import sweep_blocked

ARENA = 2.2  # m from the table's centre within which the robot is driven around the paper's
WIDE_ARENA = 3.5  # the same around other tables, from which robots start further away
REACH = (0.3, 1.3)  # m between base and object where a grasp may be possible or not


@dataclass(frozen=True)
class Scenes:
    """The scenes in which data are collected.

    Attributes:
        world: Makes the world of given scenarios.
        kind: The kind of scenarios, as in `DRAWS`; for an edge, objects are along all edges.
        thrift: From 1 on, how sparingly the world is asked for more answers than needed; higher if
            each answer is a simulation.
    """

    world: Callable[[Scenarios], ObservedTabletop]
    kind: str = "perimeter"
    thrift: int = 1

    @property
    def paper_table(self) -> bool:
        """Whether the table is the paper's."""
        return self.kind in PLACEMENTS

    @property
    def arena(self) -> float:
        """The radius (m) around the table's centre within which the robot is driven."""
        return ARENA if self.paper_table else WIDE_ARENA

    @property
    def footprint(self) -> Tensor:
        """(4,) of the base (m)."""
        return self.world(self.draw(0, Generator())).footprint

    def draw(self, count: int, generator: Generator) -> Scenarios:
        """Scenarios, whose initial robot pose is not used; SettingsError for an unknown kind."""
        return draw_of("perimeter" if self.paper_table else self.kind)(count, generator)


def poses_around(scenes: Scenes, count: int, generator: Generator, wider: float = 1.0) -> Scenarios:
    """Scenarios with the robot at a uniform free pose in an arena `wider` times the usual one."""
    arena = wider * scenes.arena

    def put(base: Scenarios) -> Tensor:
        pose = 2 * torch.rand(len(base), 3, generator=generator) - 1
        return pose * torch.tensor([arena, arena, torch.pi])

    return _free_poses(scenes, count, generator, put)


def poses_at_object(scenes: Scenes, count: int, generator: Generator) -> Scenarios:
    """Scenarios with free poses, uniform in side, heading and distance up to just out of reach."""

    def put(base: Scenarios) -> Tensor:
        part = torch.rand(len(base), 3, generator=generator)
        distance = REACH[0] + (REACH[1] - REACH[0]) * part[:, 0]
        bearing, heading = (torch.pi * (2 * part[:, 1:] - 1)).unbind(1)
        offset = rotate(torch.stack([distance, torch.zeros_like(distance)], 1), bearing)
        return torch.cat([base.object + offset, heading[:, None]], 1)

    return _free_poses(scenes, count, generator, put)


def in_table(scenarios: Scenarios, footprint: Tensor) -> Tensor:
    """(B,) bool, whether the base overlaps the table or an obstacle."""
    still = torch.zeros_like(scenarios.pose)
    inside = torch.zeros(len(scenarios), dtype=torch.bool)
    for thing in (scenarios.table[:, :5], *scenarios.obstacles.unbind(1)):
        here = rectangle_in_frame(scenarios.pose, thing)
        inside |= present(thing) & sweep_blocked(still, here, footprint)
    return inside


def _free_poses(
    scenes: Scenes, count: int, generator: Generator, put: Callable[[Scenarios], Tensor]
) -> Scenarios:
    """`count` scenarios with the robot placed by `put` (n, 3), where the base is free."""
    found, footprint = scenes.draw(0, Generator()), scenes.footprint
    while len(found) < count:
        base = scenes.draw(2 * (count - len(found)) + 8, generator)
        drawn = replace(base, pose=put(base))
        found = found.joined(drawn[~in_table(drawn, footprint)])
    return found[:count]
