"""Scenarios, and those of section VI: a robot in front of a table with an object near an edge."""

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from cgtorch.ground.environment import ScenarioBatch
from cgtorch.ground.errors import SettingsError

TABLE_DEPTH, TABLE_WIDTH, TABLE_HEIGHT = 0.8, 1.2, 0.74
START_DISTANCE, START_SPREAD, START_SIDEWAYS = 1.0, 0.2, 0.2
START_HEADING = torch.pi / 36  # 5°
INSET_MIN, INSET_MAX = 0.05, 0.15
EDGES = ("near", "left", "right", "far")
PLACEMENTS = (*EDGES, "perimeter")


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
    obstacles: Tensor = field(default_factory=lambda: torch.zeros(0, 0, 5))

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
