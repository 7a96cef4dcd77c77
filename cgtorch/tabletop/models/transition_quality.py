"""How good Γ is on fresh transitions, beside how good any model can be."""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch.domains.transition import TransitionModel
from cgtorch.environment import start_lanes
from cgtorch.tabletop.data.collect import random_motions
from cgtorch.tabletop.data.poses import PERIMETER, Scenes, WorldOf, poses_around
from cgtorch.tabletop.models.transition_bayes_error import possible_next, weighted_median
from cgtorch.tabletop.world.geometry import moved
from cgtorch.tabletop.world.percepts import TABLETOP, percept_of


@dataclass(frozen=True)
class TransitionQuality:
    """Errors of Γ on transitions that it was not fitted on, in metres.

    A floor is the error, on the same transitions, of the median of all that may follow given the
    percept and the motion (`cgtorch.tabletop.models.transition_bayes_error`); its expectation is
    the least that any model can have.

    Attributes:
        rows: Transitions.
        object_error: Mean absolute error of object x and y as seen after the motion.
        object_floor: Its floor: the noise of the motion and of both looks.
        object_offset: Mean absolute difference from where a motion without noise would have led
            and a look without noise would have seen it: the error that is Γ's and its percept's.
        table_error: Mean absolute error of the table's four numbers.
        table_floor: Its floor: noise, and to which side the table may be turned.
        object_floor_error: Standard error of `object_floor`.
        table_floor_error: Standard error of `table_floor`.
        table_excess_error: Standard error of table_error - table_floor, row by row.
    """

    rows: int
    object_error: float
    object_floor: float
    object_offset: float
    table_error: float
    table_floor: float
    object_floor_error: float
    table_floor_error: float
    table_excess_error: float


@dataclass(frozen=True)
class FreshTransitions:
    """Transitions with what really happened: percept, motion, next percept, next without noise.

    Attributes:
        percept: (n, D).
        motion: (n, 3).
        next_percept: (n, D) as seen.
        exact: (n, 7) the same without any noise of motion or of the second look.
    """

    percept: Tensor
    motion: Tensor
    next_percept: Tensor
    exact: Tensor


def transition_quality(
    world_of: WorldOf,
    model: TransitionModel,
    count: int,
    generator: Generator,
    scenes: Scenes = PERIMETER,
) -> TransitionQuality:
    """Γ's errors on `count` fresh transitions, and their floors.

    Args:
        world_of: makes the world of given scenarios.
        model: a fitted Γ.
        count: transitions; 500 take about a second.
        generator: of all random choices.
        scenes: to draw from.
    """
    fresh = fresh_transitions(world_of, count, generator, scenes)
    possible, weight = possible_next(world_of, fresh.percept, fresh.motion, generator, scenes)
    seen = fresh.next_percept[:, :TABLETOP]
    best = (weighted_median(possible, weight) - seen).abs()
    with torch.no_grad():
        answer = model(fresh.percept, fresh.motion)[:, :TABLETOP]
    error, offset = (answer - seen).abs(), (answer - fresh.exact).abs()
    table, table_best = error[:, :4].mean(1), best[:, :4].mean(1)
    placed_best = best[:, 4:6].mean(1)
    return TransitionQuality(
        rows=count,
        object_error=float(error[:, 4:6].mean()),
        object_floor=float(placed_best.mean()),
        object_offset=float(offset[:, 4:6].mean()),
        table_error=float(table.mean()),
        table_floor=float(table_best.mean()),
        object_floor_error=_standard_error(placed_best),
        table_floor_error=_standard_error(table_best),
        table_excess_error=_standard_error(table - table_best),
    )


def _standard_error(values: Tensor) -> float:
    """Standard error of the mean of values (n,)."""
    return float(values.std() / len(values) ** 0.5)


def fresh_transitions(
    world_of: WorldOf, count: int, generator: Generator, scenes: Scenes = PERIMETER
) -> FreshTransitions:
    """`count` random motions from random poses around the table that can be carried out.

    Poses, motions and limits are those of `cgtorch.tabletop.data.collect`.
    """
    parts: list[tuple[Tensor, ...]] = []
    have = 0
    while have < count:
        placed = poses_around(world_of, 2 * (count - have) + 8, generator, scenes)
        motion = random_motions(len(placed), generator)
        world = world_of(placed)
        before = start_lanes(world, torch.arange(len(placed)), 0, 0)
        after, ok = world.step(before, motion)
        for state in (before.state, after.state):
            ok = ok & (state[:, :2].norm(dim=1) <= scenes.arena)
        exact = percept_of(moved(placed.pose, motion), placed.table, placed.object)
        parts.append((before.percept[ok], motion[ok], after.percept[ok], exact[ok]))
        have += int(ok.sum())
    return FreshTransitions(*(torch.cat(part)[:count] for part in zip(*parts, strict=True)))
