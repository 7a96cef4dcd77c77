"""Which motions MoveBase can make: those whose way is clear of the table and of obstacles."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.native import function, structure, suits, threads
from cgtorch.tabletop.world.percepts import parts_of, present
from cgtorch.tabletop.world.sweep import sweep_blocked

MAX_TRANSLATION = 2.5  # m; a navigation goal further away is refused
CLEARANCE = 0.02  # m kept between base and table, four times the odometry noise
WORTH_SHARING = 4096  # motions that are worth one more thread


def motion_possible(
    motion: Tensor, things: Tensor, footprint: Tensor, farthest: float = MAX_TRANSLATION
) -> Tensor:
    """(n,) bool, whether the base can make motions (n, 3) beside things in its frame.

    False where the swept footprint (4,) would come within `CLEARANCE` of one of them, for ways of
    more than `farthest` m, and for motions that are not finite. Things are a table (n, 5), or the
    table and obstacles (n, R, 5); one of size 0 is none.
    """
    if things.dim() == 2:
        things = things[:, None]
    call = function("motions_possible", motion.dtype) if suits(motion, things, footprint) else None
    if call is None:
        return motion_possible_in_torch(motion, things, footprint, farthest)
    n, body = len(motion), body_structure(footprint, farthest)
    motion, things = motion.contiguous(), things.expand(n, -1, -1).contiguous()
    free, share = torch.empty(n, dtype=torch.bool), max(1, min(threads(), n // WORTH_SHARING))
    call(motion, things, body, n, things.shape[1], free, share)
    return free


def motion_possible_in_torch(
    motion: Tensor, things: Tensor, footprint: Tensor, farthest: float = MAX_TRANSLATION
) -> Tensor:
    """The same on any device, for things (n, R, 5)."""
    short = motion[:, :2].norm(dim=1) <= farthest
    free = short & torch.isfinite(motion).all(1)
    for thing in things.unbind(1):
        free = free & ~(present(thing) & sweep_blocked(motion, thing, footprint, CLEARANCE))
    return free


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class ClearMotion:
    """MoveBase's own check on percepts: the way must be clear of table and obstacles as seen.

    Attributes:
        footprint: (4,) of the base (m).
    """

    footprint: Tensor

    def __call__(self, percept: Tensor, motion: Tensor) -> Tensor:
        """(n,) bool for percepts (n, D) and motions (n, 3)."""
        return motion_possible(motion, parts_of(percept).things, self.footprint)


def body_structure(footprint: Tensor, farthest: float = MAX_TRANSLATION) -> Any:
    """The base as compiled code knows it."""
    x0, x1, y0, y1 = footprint.tolist()
    return structure("Body", footprint.dtype)(
        bx=(x0 + x1) / 2,
        by=(y0 + y1) / 2,
        hx=(x1 - x0) / 2 + CLEARANCE,
        hy=(y1 - y0) / 2 + CLEARANCE,
        farthest=farthest,
    )
