"""Where on a table the scenes put objects: their density, which no percept shows."""

import torch
from torch import Tensor

from cgtorch.tabletop.world.scenarios import INSET_MAX, INSET_MIN


def placement_density(
    at: Tensor, sides: Tensor, insets: tuple[float, float] = (INSET_MIN, INSET_MAX)
) -> Tensor:
    """Density (..., per m²) of objects at (..., 2) in the frame of a table of sides (..., 2).

    That of `random_scenarios("perimeter")`, or with other insets of `general_scenarios`: an edge is
    drawn by its length, then a place along it and a distance from it.
    """
    low, high = insets
    density = torch.zeros_like(at[..., 0])
    for axis in (0, 1):
        long, half = sides[..., 1 - axis], sides[..., axis] / 2
        inset = half - at[..., axis].abs()
        for distance in (inset, 2 * half - inset):  # from the near edge and from the far one
            inside = (distance >= low) & (distance <= high)
            inside &= at[..., 1 - axis].abs() <= long / 2 - INSET_MIN
            area = (high - low) * (long - 2 * INSET_MIN)
            density = density + inside * long / (2 * sides.sum(-1) * area)
    return density
