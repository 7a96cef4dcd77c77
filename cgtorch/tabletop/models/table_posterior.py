"""The posterior of tables given a percept, for tables of any size and yaw.

The prior is that of `cgtorch.tabletop.world.general`. Tables are sampled by importance sampling
(Kahn & Marshall 1953). A box and a yaw determine the sides of its rectangle, so if only the box is
seen, any yaw is drawn. If the yaw is seen, the sides are as seen except for noise.
"""

from collections.abc import Callable

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.models.geometry import CENTRE, EXTENTS, OBJECT, to_parts
from cgtorch.tabletop.world.general import INSET, SIDE
from cgtorch.tabletop.world.geometry import rotate
from cgtorch.tabletop.world.percepts import parts_of
from cgtorch.tabletop.world.scenarios import INSET_MAX, INSET_MIN

_FLATTEST = 1e-3  # of the determinant that gives the sides; at 45° only their sum is known
OUTLIER = 1e-6  # weight, relative to a whole table, of what the scenes are said not to contain


def tables_behind(
    percept: Tensor, blur: float, samples: int, generator: Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Samples of tables (n, S, 5), objects (n, S, 2) and weights (n, S) given percepts (n, D).

    They are in the base frame. Percepts have noise with a standard deviation of `blur` (m).
    """
    side = parts_of(percept).side
    parts = to_parts(percept)[:, None].expand(-1, samples, -1)

    def noise(deviation: float, size: int) -> Tensor:
        return deviation * torch.randn(len(percept), samples, size, generator=generator)

    # A centre is the mean of two numbers with noise, an extent their difference.
    centre = parts[..., CENTRE] - noise(blur / 2**0.5, 2)
    placed = parts[..., OBJECT] - noise(blur, 2)
    if side.shape[-1]:
        shape, weight = _seen_sides(parts, side, blur, noise)
    else:
        shape, weight = _any_yaw(parts[..., EXTENTS] - noise(blur * 2**0.5, 2), generator)
    sides = shape[..., 1:].clamp(*SIDE)
    weight = weight * (shape[..., 1:] == sides).all(-1)
    yaw = shape[..., :1]
    density = placement_density(rotate(placed - centre, -yaw[..., 0]), sides, INSET)
    # Where no sample fits, all that are left are as likely.
    return torch.cat([centre, yaw, sides], -1), placed, weight * (density + OUTLIER) + OUTLIER**2


def _any_yaw(extents: Tensor, generator: Generator) -> tuple[Tensor, Tensor]:
    """Yaws and their sides (n, S, 3) given extents (n, S, 2), and weights (n, S)."""
    yaw = torch.pi * torch.rand(extents.shape[:2], generator=generator)
    c, s = yaw.cos().abs(), yaw.sin().abs()
    w, h = extents.unbind(-1)
    both = c.square() - s.square()
    safe = torch.where(both.abs() < _FLATTEST, _FLATTEST, both)
    sides = torch.stack([(w * c - h * s) / safe, (h * c - w * s) / safe], -1)
    return torch.cat([yaw[..., None], sides], -1), 1 / safe.abs()


def _seen_sides(
    parts: Tensor, side: Tensor, blur: float, noise: Callable[[float, int], Tensor]
) -> tuple[Tensor, Tensor]:
    """Yaw and sides (n, S, 3) if a side (n, 2) is seen, and weights (n, S).

    The box has two extents for the one remaining side. One combination of them gives this side; the
    other gives the likelihood of yaw and length.
    """
    seen = side[:, None] - noise(blur, 2)
    yaw, length = torch.atan2(seen[..., 1], seen[..., 0]) / 2, seen.norm(dim=-1)
    c, s = yaw.cos().abs(), yaw.sin().abs()
    w, h = parts[..., 2] - length * c, parts[..., 3] - length * s
    other = s * w + c * h + noise(blur * 2**0.5, 1)[..., 0]
    misfit = (c * w - s * h).square() / (4 * blur**2)
    return torch.stack([yaw, length, other], -1), torch.exp(-misfit) / length


def placement_density(
    at: Tensor, sides: Tensor, insets: tuple[float, float] = (INSET_MIN, INSET_MAX)
) -> Tensor:
    """Density (..., per m²) of objects at (..., 2) in the frame of a table with sides (..., 2).

    It is that of `random_scenarios("perimeter")`, or with other insets of `general_scenarios`: an
    edge is drawn by its length, then a place along it and a distance from it.
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
