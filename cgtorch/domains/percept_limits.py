"""Which percepts are possible: bounds of numbers, and pairs that are a sine and a cosine."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

from torch import Tensor

from cgtorch.ground.fields import Field, bounds_of

ROUND = 1e-4  # the largest spread of the radius of a pair that stays on a circle, as its share
MOVING = 1e-2  # the smallest spread of each number of such a pair, as a share of the radius


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Limits:
    """The limits of percepts.

    Attributes:
        low: (D,) the smallest possible numbers.
        high: (D,) the largest.
        circles: Places of two numbers whose squares have the same sum in all percepts, and the
            square root of that sum.
    """

    low: Tensor
    high: Tensor
    circles: tuple[tuple[int, int, float], ...] = ()

    @classmethod
    def found(cls, fields: Sequence[Field], percepts: Tensor) -> Self:
        """The limits of D fields, and the circles on which all percepts (n, D) lie."""
        low, high = (bound.double() for bound in bounds_of(fields))
        return cls(low, high, circles_in(percepts.double()))

    def valid(self, percept: Tensor) -> Tensor:
        """The possible percepts (n, D) that are nearest to given ones."""
        percept = percept.clamp(self.low.to(percept), self.high.to(percept))
        for i, j, radius in self.circles:
            share = radius / percept[:, i].hypot(percept[:, j]).clamp_min(1e-6 * radius)
            percept[:, i] *= share
            percept[:, j] *= share
        return percept

    def inside(self, percept: Tensor) -> Tensor:
        """(n,) bool, whether percepts (n, D) are away from bounds, which hide how far they went.

        A number that mostly is at a bound is no motion that was cut off there.
        """
        near = (percept <= self.low.to(percept)) | (percept >= self.high.to(percept))
        usual = near.float().mean(0) > 0.5
        return ~(near & ~usual).any(1)


def circles_in(percepts: Tensor) -> tuple[tuple[int, int, float], ...]:
    """The circles around 0 on which pairs of the numbers of percepts (n, D) move."""
    found, taken = list[tuple[int, int, float]](), set[int]()
    if len(percepts) < 2:
        return ()
    for i, j in combinations(range(percepts.shape[1]), 2):
        radius = percepts[:, [i, j]].norm(dim=1)
        size, spread = float(radius.mean()), float(radius.std())
        moves = float(percepts[:, [i, j]].std(0).min()) > MOVING * size
        if not {i, j} & taken and moves and spread < ROUND * size:
            found.append((i, j, size))
            taken |= {i, j}
    return tuple(found)
