"""The quality of Γ on fresh transitions, beside the best that is possible.

The box around a turned rectangle does not show how it is turned, so the next percept has a
distribution, and no model has a smaller error than its median. This distribution can be sampled by
importance sampling (Kahn & Marshall 1953), as that of the scenes is known. Tables are drawn as in
the world and kept in proportion to their likelihood given the box; the object and the motion weigh
them.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch.domains.transition import TransitionModel
from cgtorch.environment import start_lanes
from cgtorch.tabletop.data import Scenes
from cgtorch.tabletop.data.motions import random_motions
from cgtorch.tabletop.data.poses import poses_around
from cgtorch.tabletop.models.table_posterior import OUTLIER, placement_density, tables_behind
from cgtorch.tabletop.world import motion_possible
from cgtorch.tabletop.world.geometry import (
    bounding_box,
    box_rectangle,
    moved,
    rectangle_in_frame,
    rotate,
)
from cgtorch.tabletop.world.percepts import TABLETOP, parts_of, percept_of

_POOL = 64  # scenarios whose noise is drawn from
_SMALLEST_BLUR = 1e-3  # m; below it the drawn tables would lie too far apart
_CANDIDATES = 8192  # tables drawn as the paper's scenes show them


@dataclass(frozen=True)
class TransitionQuality:
    """Errors of Γ on transitions to which it was not fitted, in metres.

    A floor is the error, on the same transitions, of the median of all possible next percepts
    (`possible_next`). Its expectation is the least error of any model.

    Attributes:
        rows: Number of transitions.
        object_error: Mean absolute error of the object's x and y as seen after the motion.
        object_floor: Its floor: the noise of the motion and of both percepts.
        object_offset: Mean absolute difference to the next percept without noise of motion and
            second percept: the error due to Γ and the first percept.
        table_error: Mean absolute error of the table's four numbers.
        table_floor: Its floor: noise, and to which side the table may be turned.
        table_floor_error: Standard error of `table_floor`.
        table_excess_error: Standard error of table_error - table_floor, row by row.
    """

    rows: int
    object_error: float
    object_floor: float
    object_offset: float
    table_error: float
    table_floor: float
    table_floor_error: float
    table_excess_error: float


@dataclass(frozen=True)
class FreshTransitions:
    """Transitions with the true result: percept, motion, next percept, next without noise.

    Attributes:
        percept: (n, D).
        motion: (n, 3).
        next_percept: (n, D) as seen.
        exact: (n, 7) the same without noise of the motion or of the second percept.
    """

    percept: Tensor
    motion: Tensor
    next_percept: Tensor
    exact: Tensor


def transition_quality(
    scenes: Scenes, model: TransitionModel, count: int, generator: Generator
) -> TransitionQuality:
    """The errors of a fitted Γ on fresh transitions, and their floors; 500 take about a second."""
    fresh = fresh_transitions(scenes, count, generator)
    possible, weight = possible_next(scenes, fresh.percept, fresh.motion, generator)
    seen = fresh.next_percept[:, :TABLETOP]
    with torch.no_grad():
        answer = model(fresh.percept, fresh.motion)[:, :TABLETOP]
    best, error, offset = (
        parts_of(difference.abs())
        for difference in (
            weighted_median(possible, weight) - seen, answer - seen, answer - fresh.exact,
        )
    )  # fmt: skip
    table, table_best = error.box.mean(1), best.box.mean(1)
    return TransitionQuality(
        rows=count,
        object_error=float(error.object.mean()),
        object_floor=float(best.object.mean(1).mean()),
        object_offset=float(offset.object.mean()),
        table_error=float(table.mean()),
        table_floor=float(table_best.mean()),
        table_floor_error=_standard_error(table_best),
        table_excess_error=_standard_error(table - table_best),
    )


def _standard_error(values: Tensor) -> float:
    """Standard error of the mean of values (n,)."""
    return float(values.std() / len(values) ** 0.5)


def fresh_transitions(scenes: Scenes, count: int, generator: Generator) -> FreshTransitions:
    """`count` random motions that can be carried out, as in `cgtorch.tabletop.data.collect`."""
    parts: list[tuple[Tensor, ...]] = []
    have = 0
    while have < count:
        spare = (count - have) // scenes.thrift + 8
        placed = poses_around(scenes, count - have + spare, generator)
        motion = random_motions(len(placed), generator)
        world = scenes.world(placed)
        before = start_lanes(world, torch.arange(len(placed)), 0, 0)
        after, ok = world.step(before, motion)
        for state in (before.state, after.state):
            ok = ok & (state[:, :2].norm(dim=1) <= scenes.arena)
        exact = percept_of(moved(placed.pose, motion), placed.table, placed.object)
        parts.append((before.percept[ok], motion[ok], after.percept[ok], exact[ok]))
        have += int(ok.sum())
    return FreshTransitions(*(torch.cat(part)[:count] for part in zip(*parts, strict=True)))


def possible_next(
    scenes: Scenes, percept: Tensor, motion: Tensor, generator: Generator, samples: int = 256
) -> tuple[Tensor, Tensor]:
    """Next percepts (n, S, 7) and weights (n, S) of sum 1, for percepts (n, D) and motions (n, 3).

    The motions have been carried out, so they are known to be possible.
    """
    world = scenes.world(scenes.draw(_POOL, generator))
    drift, blur = world.drift.flatten(0, 1), world.blur.flatten(0, 1)[:, :TABLETOP]
    deviation, shape = float(blur.std().clamp_min(_SMALLEST_BLUR)), (len(percept), samples)

    def some() -> Tensor:
        return torch.randint(len(blur), shape, generator=generator)

    if scenes.paper_table:
        look = blur[some()]
        shapes = _likely_shapes(scenes, percept, deviation, samples, generator)
        rectangle, placed, weight = _one_table(percept, shapes, look)
    else:
        rectangle, placed, weight = tables_behind(percept, deviation, samples, generator)
    many = motion[:, None].expand(*shape, 3)
    free = motion_possible(many.flatten(0, 1), rectangle.flatten(0, 1), world.footprint)
    weight = weight * (free.view(shape) + OUTLIER)
    pick, then = some(), some()
    # The height has the noise of both looks.
    height = parts_of(percept[:, None]).height - parts_of(blur[some()]).height
    pose = moved(torch.zeros_like(many), many + drift[pick])
    next_percept = percept_of(pose, torch.cat([rectangle, height], -1), placed) + blur[then]
    return next_percept, weight / weight.sum(1, keepdim=True)


def _one_table(percept: Tensor, shapes: Tensor, look: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Tables (n, S, 5), objects (n, S, 2) and weights (n, S) of the paper's scenes.

    Given are percepts (n, D), yaws and sides (n, S, 3), and the noise of percepts (n, S, 7).
    """
    seen = parts_of(percept[:, None, :TABLETOP] - look)
    centre = box_rectangle(seen.box)[..., :2]
    weight = placement_density(rotate(seen.object - centre, -shapes[..., 0]), shapes[..., 1:])
    return torch.cat([centre, shapes], -1), seen.object, weight + OUTLIER


def _likely_shapes(
    scenes: Scenes, percept: Tensor, deviation: float, samples: int, generator: Generator
) -> Tensor:
    """Yaw and sides (n, S, 3) of tables drawn as in the world, given percepts (n, D)."""
    drawn = poses_around(scenes, _CANDIDATES, generator)
    tables = rectangle_in_frame(drawn.pose, drawn.table[:, :5])
    size, seen = (
        box_rectangle(box)[:, 3:] for box in (bounding_box(tables), parts_of(percept).box)
    )
    # An extent is the difference of two numbers with noise.
    score = -torch.cdist(seen, size).square() / (4 * deviation**2)
    chance = (score - score.amax(1, keepdim=True)).exp()
    pick = torch.multinomial(chance, samples, replacement=True, generator=generator)
    return tables[pick][..., 2:]


def weighted_median(values: Tensor, weight: Tensor) -> Tensor:
    """Medians (n, k) of samples (n, S, k) with weights (n, S) that sum to 1 in each row."""
    ordered, place = values.sort(1)
    share = weight[..., None].expand_as(values).gather(1, place).cumsum(1)
    middle = (share < 0.5).sum(1, keepdim=True).clamp_max(values.shape[1] - 1)
    return ordered.gather(1, middle)[:, 0]
