"""Collecting the first data for Γ and C in any domain, by few motions that teach much.

Motions are drawn from those that the domain calls worth trying. As soon as there are models, most
of them end where C is unsure, so one motion gives a transition and an informative test. Exploration
ends when more data hardly improve Γ, and C expects success where it was met.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Generator, Tensor

from cgtorch.domains.knowledge import Knowledge
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Dataset, Environment, Episodic, Lanes, start_lanes
from cgtorch.ground.errors import DataError, DomainError
from cgtorch.ground.fields import Field, bounds_of, columns_of
from cgtorch.native.processes import counted

EXPLORATION = "exploration"
"""The phase of world actions."""
CHAIN = 6  # motions, one after the other, from each start
FIRST = 6  # motions of the first part; later parts are half as many as there are
CANDIDATES = 48  # controls among which the most informative is chosen
BOLD = 0.7  # share of motions that end where C is unsure; the others are drawn blindly
TRIES = 8  # to draw controls of which one is possible
LEAST = 10  # transitions that Γ needs
FEWEST = 3  # tests of either result that C needs
GOOD, GAIN = 0.65, 0.8
"""Γ is good enough at this share of the error without a machine, or if the last part of the data
has not brought its error below this share of what it was."""
BELIEVED = 0.5  # share of the successes that C has to expect, or no skill would ever test
RARE = (
    "give scenarios that begin nearer to success, say which controls are worth trying "
    "(Models.worth_trying), implement explore, or evolve in the world: "
    "models 'none' (--models none)"
)
OFTEN = (
    "is the test of success right (succeeded)? If so, give scenarios that begin farther from it, "
    "so that some motions miss it"
)
"""What to do where success was met too rarely, and where it was hardly ever missed."""


@dataclass(frozen=True)
class Exploration:
    """The inputs of an exploration.

    Attributes:
        kind: The kind of scenarios.
        worlds: Makes the world of n fresh scenarios of a kind; its world actions are counted.
        fit: Fits models to data.
        most: The largest number of motions.
        lanes: The number of robots that act side by side.
        generator: Of all random choices.
        purse: Counts what is asked.
        known: Data of an exploration that was interrupted; None if it begins.
        live: Whether the world is a robot, which goes on from where it is.
    """

    kind: str
    worlds: Callable[[str, int], Environment]
    fit: Callable[[Dataset], Knowledge]
    most: int
    lanes: int
    generator: Generator
    purse: Purse
    known: Dataset | None = None
    live: bool = False


class Explored(Protocol):
    """The part of the models that an exploration uses; see `cgtorch.domains.models.Models`."""

    def worth_trying(self, percept: Tensor, count: int, generator: Generator) -> Tensor:
        """(n, U) random controls to try at a percept (D,)."""

    def worth_testing(self, percept: Tensor) -> Tensor:
        """(n,) bool, whether to test success at percepts (n, D)."""

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        """(n,) bool, whether controls (n, U) can be carried out at percepts (n, D)."""


def random_controls(control: Sequence[Field], count: int, generator: Generator) -> Tensor:
    """(n, U) controls, uniform within the bounds of their fields; DomainError without bounds."""
    low, high = bounds_of(control)
    for field in control:
        if max(abs(field.low), abs(field.high)) == float("inf"):
            raise DomainError(
                f"control {field.name!r} has no bounds, between which it could be tried at random; "
                "give its Field low and high, or implement worth_trying"
            )
    share = torch.rand(count, len(control), generator=generator)
    drawn = low + (high - low) * share
    for i in columns_of(control, "discrete"):  # each whole number as often as any other
        whole = low[i] + (high[i] - low[i] + 1) * share[:, i]
        drawn[:, i] = whole.floor().clamp(max=high[i])
    return drawn


def explore(models: Explored, about: Exploration) -> Dataset:
    """Transitions (p, u, p′) and tests of success from few motions.

    Raises:
        DataError: Within `about.most` motions almost all tests succeed, or almost none.
        DomainError: A control has no bounds.
        BudgetSpentError: The budget does not cover the data that models need.
    """
    without = counted("motions without success", about.most)
    try:
        return _explored(models, about, without)
    finally:
        without(about.most)


def _explored(models: Explored, about: Exploration, without: Callable[[int], None]) -> Dataset:
    """The data of an exploration, which counts motions as long as there is no success."""
    robots, error = _Robots(models, about), float("inf")
    data, known = about.known or robots.moved(None, FIRST), None
    told = 0
    while True:
        without(about.most if data.succeeded.any() else robots.motions - told)
        told = robots.motions
        if _rarer(data) >= FEWEST and len(data.percept) >= LEAST:
            before, known = error, about.fit(data)
            error = _error(known)
            settled = error <= GOOD or (before < float("inf") and error > GAIN * before)
            if settled and _believed(known, data) >= BELIEVED:
                return data
        if robots.motions >= about.most:
            break
        more = FIRST if known is None else max(FIRST, robots.motions // 2)
        data = data.extended(robots.moved(known, more))
    if known is None:
        few, tests = _rarer(data), len(data.succeeded)
        rare = few == int(data.succeeded.sum())
        raise DataError(
            f"success was {'missed' if rare else 'met'} in {tests - few} of {tests} tests "
            f"of {len(data.percept)} motions, and {FEWEST} of either result are needed; "
            f"{RARE if rare else OFTEN}"
        )
    return data


class _Robots:
    """Robots that explore side by side, each from a fresh start after `CHAIN` motions.

    A live one goes on from where it is, since a fresh start has to be arranged by hand.
    """

    def __init__(self, models: Explored, about: Exploration):
        self._models, self._about = models, about
        self._world: Environment | None = None
        self._lanes: Lanes | None = None
        self._left = 0
        self.motions = 0 if about.known is None else len(about.known.percept)

    def moved(self, known: Knowledge | None, motions: int) -> Dataset:
        """Data of about so many motions of all robots together."""
        about, models = self._about, self._models
        moved, tested = list[tuple[Tensor, ...]](), list[tuple[Tensor, ...]]()
        until = self.motions + motions
        while self.motions < until:
            world, lanes = self._started()
            control = torch.cat([_chosen(models, known, p, about) for p in lanes.percept])
            after, done = world.step(lanes, control)
            self.motions += len(lanes)
            moved.append((lanes.percept[done], control[done], after.percept[done]))
            rows = models.worth_testing(after.percept).nonzero()[:, 0]
            if len(rows):
                some, chance = world.success(after.rows(rows))
                tested.append((after.percept[rows], chance > 0.5))
                after = after.with_rows(rows, some)
            if isinstance(world, Episodic):  # where an episode is over, nothing happens any more
                after = after.rows((~world.over(after)).nonzero()[:, 0])
            self._lanes, self._left = after, self._left - 1 if len(after) else 0
        nothing = lanes.percept[:0], torch.empty(0, dtype=torch.bool)
        p, u, q = (torch.cat(part) for part in zip(*moved, strict=True))
        seen, labels = (torch.cat(part) for part in zip(nothing, *tested, strict=True))
        return Dataset(p, u, q, seen, labels)

    def _started(self) -> tuple[Environment, Lanes]:
        """The world and its lanes, fresh ones if a chain of motions is over."""
        count = self._about.lanes
        if self._world is None or self._lanes is None or not (self._left or self._about.live):
            self._world = self._about.worlds(self._about.kind, count)
            self._lanes = start_lanes(self._world, torch.arange(count), 0, 0)
            self._left = CHAIN
        return self._world, self._lanes


def _chosen(
    models: Explored, known: Knowledge | None, percept: Tensor, about: Exploration
) -> Tensor:
    """(1, U) a control for a percept (D,): a random one, or one that ends where C is unsure."""
    for _ in range(TRIES):
        drawn = models.worth_trying(percept, CANDIDATES, about.generator)
        here = percept.expand(len(drawn), -1).contiguous()
        able = models.possible(here, drawn)
        if able.any():
            break
    else:
        return drawn[:1]
    drawn, here = drawn[able], here[able]
    bold = float(torch.rand((), generator=about.generator)) < BOLD
    if known is None or not bold:
        return drawn[:1]
    with torch.no_grad():
        predicted = known.gamma(here, drawn)
        unsure = (known.classifier(predicted) - 0.5).abs()
    return drawn[unsure.argmin()][None]


def _rarer(data: Dataset) -> int:
    """The number of tests with the rarer result."""
    return min(int(data.succeeded.sum()), int((~data.succeeded).sum()))


def _believed(known: Knowledge, data: Dataset) -> float:
    """The share of successful tests that C expects to succeed."""
    with torch.no_grad():
        return float((known.classifier(data.tested[data.succeeded]) > 0.5).float().mean())


def _error(known: Knowledge) -> float:
    """Γ's mean cross-validated error, as a share of that of a model without a machine."""
    report = known.gamma_report
    pairs = zip(report.error, report.baseline_error, strict=True)
    shares = [error / baseline for error, baseline in pairs if baseline > 0]
    return sum(shares) / max(1, len(shares))
