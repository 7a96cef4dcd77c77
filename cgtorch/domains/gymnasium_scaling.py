"""How observations become percepts around 1: by the spread of what was seen, or by bounds."""

from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.domains.gymnasium_limits import beyond, bounds_of_percepts
from cgtorch.domains.gymnasium_spaces import Percepts

EVEN = 1e-9  # the largest spread of numbers that do not vary, as a share of the largest
FAIR = 0.01
"""The part of the range within bounds that has to be seen, or the bounds do not scale a number. A
percept of less would need weights of some hundred, and skills begin with weights of about 1."""


@dataclass(frozen=True)
class Scaling:
    """How observations become percepts: subtract an offset (D,), and divide by a scale (D,)."""

    centre: Tensor
    scale: Tensor


def scaling_of(percepts: NDArray[Any]) -> Scaling:
    """The scaling of numbers (N, D) of random episodes; constant numbers are not scaled.

    Bounds can be far too wide for scaling: divided by the bounds of a velocity, all values would be
    close to 0.
    """
    seen = torch.from_numpy(percepts).double()
    exponent = torch.frexp(seen.abs().amax(0)).exponent
    share = torch.ldexp(seen, -exponent)  # of a size whose squares are neither infinite nor 0
    spread = share.std(0)
    centre, scale = torch.ldexp(share.mean(0), exponent), torch.ldexp(spread, exponent)
    return Scaling(centre, torch.where(spread > EVEN, scale, 1.0))


def scaled_by_bounds(percepts: Percepts, seen: NDArray[Any]) -> Scaling:
    """The scaling by bounds, and by what was seen (N, D) where bounds are none or say nothing.

    That is where something else than they allow was seen, or what varied did so in a small part of
    their range only.
    """
    low, high = bounds_of_percepts(percepts)
    least, most = (torch.from_numpy(each).double() for each in (seen.min(0), seen.max(0)))
    below, above = beyond(low, high, least, most)
    telling = (least == most) | (most - least >= FAIR * (high - low))
    known = low.isfinite() & high.isfinite() & (low < high) & ~(below | above) & telling
    found, middle, half = scaling_of(seen), (low + high) / 2, (high - low) / 2
    return Scaling(torch.where(known, middle, found.centre), torch.where(known, half, found.scale))


def outside(percepts: Percepts, seen: NDArray[Any]) -> str:
    """A sentence about the first number of what was seen (N, D) outside its space, or ""."""
    low, high = bounds_of_percepts(percepts)
    least, most = (torch.from_numpy(each).double() for each in (seen.min(0), seen.max(0)))
    below, above = beyond(low, high, least, most)
    if not len(wrong := (below | above).nonzero()):
        return ""
    at, others = int(wrong[0]), len(wrong) - 1
    value = least[at] if bool(below[at]) else most[at]
    more = f", and {others} more numbers" if others else ""
    return (
        f"Random episodes showed {percepts.fields[at].name} as {value:.6g}, outside its bounds "
        f"{low[at]:g} to {high[at]:g}{more}; correct the observation_space."
    )
