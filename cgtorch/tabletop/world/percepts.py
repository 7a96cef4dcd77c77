"""Percepts of the tabletop: the paper's seven numbers, and optional ones after them.

A percept is the table's box x min, x max, y min, y max and the object's x, y, z (7). If it contains
the table's yaw, one side of the table follows (2). Then comes the box of each obstacle (4K). All
are in m, in the robot's base frame. The length of a percept determines which of these it contains,
and `Percept` gives its parts their names.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.ground.fields import Field, named
from cgtorch.ground.numerics import atan2
from cgtorch.tabletop.world.geometry import (
    bounding_box,
    box_rectangle,
    rectangle_in_frame,
    to_frame,
)

PERCEPTS = {"box": 7, "yaw": 9}
"""The length of the table and object part, by the percept's name."""
TABLETOP = PERCEPTS["box"]
BOX = 4
"""Numbers per obstacle: x min, x max, y min, y max; all 0 if it is absent."""


@dataclass(frozen=True)
class Percept:
    """The parts of percepts (..., D).

    Attributes:
        box: (..., 4) of the table.
        object: (..., 2) its x and y.
        height: (..., 1) the object's z.
        side: (..., 2 or 0) of the table, as in `side_seen`.
        obstacles: (..., K, 4) their boxes.
    """

    box: Tensor
    object: Tensor
    height: Tensor
    side: Tensor
    obstacles: Tensor

    @property
    def present(self) -> Tensor:
        """(..., K) bool, which obstacles are present."""
        return (self.obstacles != 0).any(-1)

    @property
    def table(self) -> Tensor:
        """The table (..., 5) as a rectangle: the box, or its least-squares fit given the side."""
        box = box_rectangle(self.box)
        if not self.side.shape[-1]:
            return box
        length, yaw = self.side.norm(dim=-1), atan2(self.side[..., 1], self.side[..., 0]) / 2
        c, s = yaw.cos().abs(), yaw.sin().abs()
        other = s * (box[..., 3] - length * c) + c * (box[..., 4] - length * s)
        return torch.cat([box[..., :2], torch.stack([yaw, length, other.clamp_min(0)], -1)], -1)

    @property
    def things(self) -> Tensor:
        """(..., 1 + K, 5) the table, then boxes around obstacles; one of size 0 is absent."""
        table = self.table[..., None, :]
        some = self.obstacles.shape[-2] > 0
        return torch.cat([table, box_rectangle(self.obstacles)], -2) if some else table


def parts_of(percept: Tensor) -> Percept:
    """The parts of percepts (..., D); DataError if D is no length of a percept of the tabletop."""
    size = percept.shape[-1]
    tabletop = next((n for n in PERCEPTS.values() if size >= n and (size - n) % BOX == 0), None)
    if tabletop is None:
        raise DataError(
            f"a percept has {size} numbers; give 7, or 9 with the table's side, and 4 for each "
            "obstacle"
        )
    obstacles = percept[..., tabletop:].unflatten(-1, ((size - tabletop) // BOX, BOX))
    box, at, height = percept[..., :4], percept[..., 4:6], percept[..., 6:7]
    return Percept(box, at, height, percept[..., TABLETOP:tabletop], obstacles)


def percept_fields(size: int) -> tuple[Field, ...]:
    """Names and units of the numbers of percepts of a size."""
    parts = parts_of(torch.zeros(size))
    ends = ("x min", "x max", "y min", "y max")
    obstacles = (f"obstacle {k + 1} {end}" for k in range(len(parts.obstacles)) for end in ends)
    table = *(f"table {end}" for end in ends), "object x", "object y", "object z"
    return named(*table, *("side x", "side y")[: len(parts.side)], *obstacles, unit="m")


def percept_of(pose: Tensor, table: Tensor, placed: Tensor) -> Tensor:
    """The percept (..., 7), m, without noise, of pose (..., 3), table (..., 6), object (..., 2)."""
    box = bounding_box(rectangle_in_frame(pose, table[..., :5]))
    return torch.cat([box, to_frame(pose, placed), table[..., 5:6]], -1)


def side_seen(pose: Tensor, table: Tensor) -> Tensor:
    """The side (..., 2) of tables (..., 6) along their own x axis from poses (..., 3), in m.

    It is a vector without noise, as long as the side, at twice the angle from the base's x axis to
    the side. A side has no direction, and twice its angle is the same after half a turn. The other
    side follows from the box.
    """
    angle = 2 * (table[..., 2] - pose[..., 2])
    return table[..., 3:4] * torch.stack([angle.cos(), angle.sin()], -1)


def present(rectangle: Tensor) -> Tensor:
    """(...) bool, whether rectangles (..., 5) are present: they have a size."""
    return (rectangle[..., 3:] > 0).all(-1)


def obstacles_seen(pose: Tensor, obstacles: Tensor) -> Tensor:
    """Boxes (..., 4K) of obstacles (..., K, 5) from poses (..., 3) (m), without noise.

    An absent obstacle is four zeros, which no present one can be, as it has a size.
    """
    box = bounding_box(rectangle_in_frame(pose[..., None, :], obstacles))
    return (box * present(obstacles)[..., None]).flatten(-2)
