"""Collecting data for Γ and C in any domain, by random controls in the world."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Generator, Tensor

from cgtorch.environment import Dataset, Environment, start_lanes
from cgtorch.environment.fields import Field, bounds_of, columns_of
from cgtorch.ground.errors import DataError, DomainError

MOVES = 12  # random controls at most, one after the other, from each start
RARE = 0.02  # share of either label below which there is hardly anything to learn
SHARE = 0.3  # of the tests that are kept, have the rarer label if there are as many
MOST_TRIES = 40
ADVICE = (
    "give scenarios that begin nearer to success, implement explore, or evolve in the world: "
    "--models none"
)


def random_controls(control: Sequence[Field], count: int, generator: Generator) -> Tensor:
    """(n, U) controls, uniform within the bounds of their fields; DomainError without bounds."""
    low, high = bounds_of(control)
    for field in control:
        if max(abs(field.low), abs(field.high)) == float("inf"):
            raise DomainError(
                f"control {field.name!r} has no bounds, between which it could be tried at random; "
                "give its Field low and high, or implement explore"
            )
    share = torch.rand(count, len(control), generator=generator)
    drawn = low + (high - low) * share
    for i in columns_of(control, "discrete"):  # each whole number as often as any other
        whole = low[i] + (high[i] - low[i] + 1) * share[:, i]
        drawn[:, i] = whole.floor().clamp(max=high[i])
    return drawn


def explore(
    worlds: Callable[[int], Environment],
    control: Sequence[Field],
    transitions: int,
    tests: int,
    generator: Generator,
) -> Dataset:
    """Act at random for transitions (p, u, p′), and test success at every step.

    Both results of tests are kept, if possible with at least `SHARE` of the rarer one. `worlds`
    makes the world of that many random scenarios.

    Raises:
        DataError: Almost all tests succeed, or almost none.
        DomainError: A control has no bounds.
    """
    moved: list[tuple[Tensor, Tensor, Tensor]] = []
    tested: list[tuple[Tensor, Tensor]] = []
    for _ in range(MOST_TRIES):
        count = 16 + max(transitions, tests) // MOVES
        world = worlds(count)
        lanes = start_lanes(world, torch.arange(count), 0, 0)
        for _ in range(MOVES):
            lanes, chance = world.success(lanes)
            tested.append((lanes.percept, chance > 0.5))
            controls = random_controls(control, count, generator)
            after, done = world.step(lanes, controls)
            moved.append((lanes.percept[done], controls[done], after.percept[done]))
            lanes = after
        have = sum(len(p) for p, _, _ in moved)
        labels = torch.cat([label for _, label in tested])
        rarer = min(int(labels.sum()), int((~labels).sum()))
        if have >= transitions and len(labels) >= tests and rarer >= SHARE * tests:
            break
    if have < transitions:
        raise DataError(
            f"only {have} random controls could be carried out, and {transitions} are needed; "
            + ADVICE
        )
    if rarer < RARE * tests:
        met = "met" if rarer == labels.sum() else "missed"
        raise DataError(
            f"success was {met} in {rarer} of {len(labels)} random tests, and "
            f"{math.ceil(RARE * tests)} are needed; {ADVICE}"
        )
    p, u, q = (torch.cat(part) for part in zip(*moved, strict=True))
    pick = torch.randperm(have, generator=generator)[:transitions]
    chosen = _chosen(labels, tests, generator)
    seen = torch.cat([percept for percept, _ in tested])
    return Dataset(p[pick], u[pick], q[pick], seen[chosen], labels[chosen])


def _chosen(labels: Tensor, count: int, generator: Generator) -> Tensor:
    """(count,) random indices of labels (n,), with a fixed share of the rarer label."""
    order = torch.randperm(len(labels), generator=generator)
    yes, no = order[labels[order]], order[~labels[order]]
    rare, rest = sorted((yes, no), key=len)
    few = max(min(len(rare), int(SHARE * count)), count - len(rest))
    both = torch.cat([rare[:few], rest[: count - few]])
    return both[torch.randperm(len(both), generator=generator)]
