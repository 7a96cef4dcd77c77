"""How percepts tell about an arm and the things around it."""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.ground.fields import Field

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Arm:
    """The layout of a percept, for primitives.

    Percepts have numbers around 1, as networks need them, so they tell positions in a unit and from
    the centre of the space that the arm works in.

    Attributes:
        names: The names of a percept's numbers; those of a place are "hand x", "hand y", "hand z".
        places: The names of the places that primitives can move to, such as "object" and "goal".
        centre: (x, y, z) of the centre, in m.
        unit: The unit of positions, in m.
    """

    names: tuple[str, ...]
    places: tuple[str, ...]
    centre: tuple[float, float, float]
    unit: float = 0.2

    @property
    def fields(self) -> tuple[Field, ...]:
        """The fields of a percept."""
        return tuple(Field(name) for name in self.names)

    def columns(self, place: str) -> slice:
        """The columns of a place's position."""
        first = self.names.index(f"{place} x")
        return slice(first, first + 3)

    def position(self, percept: Tensor, place: str) -> Tensor:
        """(n, 3) the position of a place in m, from percepts (n, D)."""
        centre = torch.tensor(self.centre, dtype=percept.dtype)
        return percept[:, self.columns(place)] * self.unit + centre

    def elapsed(self, percept: Tensor) -> Tensor:
        """(n,) the share of an episode that is over."""
        return percept[:, self.names.index("time")]

    def perceived(self, seen: Tensor, elapsed: Tensor) -> Tensor:
        """Percepts (n, D) of what is seen (n, D - 1), with positions in m, and of the time (n,)."""
        percept = torch.cat([seen, elapsed[:, None]], 1)
        for place in ("hand", *self.places):
            columns = self.columns(place)
            centre = torch.tensor(self.centre, dtype=seen.dtype)
            percept[:, columns] = (percept[:, columns] - centre) / self.unit
        return percept


def place_names(place: str) -> tuple[str, ...]:
    """The names of a place's three numbers."""
    return tuple(f"{place} {axis}" for axis in AXES)
