"""Exploring: few motions from which Γ and C of any domain learn much."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rail import LAMP, PLACE, Cart, Rail, SeeingCart, cart_with, driven, rail_with
from support import models_of, seeded
from torch import Generator, Tensor

from cgtorch import Field
from cgtorch.domains.exploration import (
    BOLD,
    CANDIDATES,
    CHAIN,
    EXPLORATION,
    FEWEST,
    FIRST,
    GAIN,
    GOOD,
    LEAST,
    TRIES,
    Exploration,
    _chosen,
    random_controls,
)
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.models import Models
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.ground.environment import Dataset, Environment, Lanes
from cgtorch.ground.errors import DataError, DomainError
from cgtorch.native.processes import listening
from cgtorch.simulation import Recording


class Tracked:
    """A world that notes all motions and tests, as the robot itself would."""

    def __init__(self, world: Rail, log: "Log"):
        self.world, self.log = world, log
        self.num_scenarios, self.percept_size = world.num_scenarios, world.percept_size
        self.control_size, self.observe = world.control_size, world.observe

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        self.log.starts.append(len(scenario))
        return self.world.start(scenario)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        self.log.motions += len(lanes)
        assert self.log.motions < 2000, "it never ends"
        after, done = self.world.step(lanes, control)
        rows = zip(lanes.percept, control, after.percept, done, strict=True)
        self.log.moved += [row[:3] for row in rows if row[3]]
        return after, done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        after, chance = self.world.success(lanes)
        self.log.tested += zip(lanes.percept, chance > 0.5, strict=True)
        return after, chance


@dataclass
class Log:
    motions: int = 0
    starts: list[int] = field(default_factory=list)
    moved: list[tuple[Tensor, ...]] = field(default_factory=list)
    tested: list[tuple[Tensor, Tensor]] = field(default_factory=list)


def believing(error: float, chance: float = 1.0) -> Any:
    """Models that err by a share of what errs without them, and expect success so surely."""
    report = SimpleNamespace(error=[error, error], baseline_error=[1.0, 0.0])
    return SimpleNamespace(
        gamma_report=report,
        gamma=lambda percept, control: percept + control.sum(1, keepdim=True),
        classifier=lambda percept: torch.full((len(percept),), chance),
    )


def fits(*errors: float) -> Callable[[Dataset], Any]:
    """What fits models that err by these shares, one after the other; the last one for good."""
    number = count()
    return lambda data: believing(errors[min(next(number), len(errors) - 1)])


def about(domain: Cart, seed: int = 0, log: Log | None = None, **given_: Any) -> Exploration:
    generator, purse, watched = seeded(seed), given_.pop("purse", Purse()), log or Log()

    def worlds(kind: str, number: int) -> Environment:
        made: Any = Tracked(domain.world(domain.draw(kind, number, generator)), watched)
        return Recording(made, purse, EXPLORATION)

    usual: dict[str, Any] = {"fit": fits(100.0), "most": 60, "lanes": 2, **given_}
    return Exploration("any", worlds, generator=generator, purse=purse, **usual)


def explored(domain: Cart, seed: int = 0, **given_: Any) -> tuple[Dataset, Log]:
    log = Log()
    return models_of(domain).explore(about(domain, seed, log, **given_)), log


@given(st.integers(0, 200), st.integers(0, 2**31))
def test_controls_are_within_the_bounds_of_their_fields(number: int, seed: int) -> None:
    found = random_controls(Cart.control, number, seeded(seed))
    assert found.shape == (number, 3)
    low, high = (torch.tensor([getattr(f, b) for f in Cart.control]) for b in ("low", "high"))
    assert ((found >= low) & (found <= high)).all()
    assert torch.equal(found[:, 2], found[:, 2].round())
    assert torch.equal(models_of(Cart()).worth_trying(torch.zeros(4), number, seeded(seed)), found)


def test_controls_are_uniform() -> None:
    found = random_controls(Cart.control, 30_000, seeded(0))
    assert found[:, 0].histc(4, -1, 1).div(30_000).tolist() == pytest.approx([0.25] * 4, abs=0.02)
    shares = [float((found[:, 2] == value).float().mean()) for value in (-1, 0, 1)]
    assert shares == pytest.approx([1 / 3] * 3, abs=0.02)


@pytest.mark.parametrize("bounds", [{"low": 0}, {"high": 0}, {}])
def test_a_control_without_bounds_is_named(bounds: dict[str, float]) -> None:
    control = (*Cart.control, Field("horn", **bounds))
    with pytest.raises(DomainError, match=r"control 'horn' has no bounds.*implement worth_trying"):
        explored(cart_with(control=control))


def decaying(start: float = 100.0, by: float = 0.5) -> Callable[[Dataset], Any]:
    """Models that become better with each part, and never good enough."""
    return fits(*(start * by**i + 1 for i in range(60)))


@settings(max_examples=15)
@given(
    most=st.integers(1, 120),
    lanes=st.integers(1, 4),
    seed=st.integers(0, 2**31),
    live=st.booleans(),
)
def test_data_are_true_and_paid_and_no_more_than_one_part_too_many(
    most: int, lanes: int, seed: int, live: bool
) -> None:
    domain, purse, log = Cart(), Purse(), Log()
    known = driven(20, 30, seed)
    given_ = about(domain, seed, log, most=most, lanes=lanes, fit=decaying(), purse=purse)
    data = models_of(domain).explore(replace(given_, known=known, live=live))
    new = slice(20, None), slice(30, None)
    assert data.whole(4)
    for name, rows in vars(known).items():
        assert torch.equal(vars(data)[name][: len(rows)], rows)
    motions, tests = len(data.percept) - 20, len(data.tested) - 30
    part = -(-max(FIRST, max(most - 1, 20) // 2) // lanes) * lanes
    assert (motions == 0) if most <= 20 else (most - 20 <= motions <= most - 21 + part)
    assert motions == tests == log.motions == len(log.tested)
    starts = (motions > 0) if live else -(-motions // (CHAIN * lanes))
    assert log.starts == [lanes] * starts
    asked = Asked(motions=motions, tests=tests, looks=lanes * starts)
    assert purse.spent == ({EXPLORATION: asked} if motions else {})
    if motions:
        moved = [torch.stack(part) for part in zip(*log.moved, strict=True)]
        named = data.percept, data.control, data.next_percept
        assert all(torch.equal(rows[new[0]], one) for rows, one in zip(named, moved, strict=True))
        assert torch.equal(data.tested[new[1]], torch.stack([p for p, _ in log.tested]))
        assert torch.equal(data.succeeded[new[1]], torch.stack([s for _, s in log.tested]))
    world = Rail(Cart().draw("any", 1, seeded(0)))
    after = world.next_state(data.percept, data.control, torch.zeros(0))
    assert torch.equal(after, data.next_percept)
    assert torch.equal(data.succeeded, world.succeeded(data.tested))


@settings(max_examples=12)
@given(st.lists(st.floats(0.05, 3), min_size=1, max_size=6), st.booleans(), st.integers(0, 2**31))
def test_it_ends_as_soon_as_more_would_hardly_help(
    errors: list[float], believed: bool, seed: int
) -> None:
    """Both results are known, Γ is good or better hardly, and C expects what was met."""
    seen: list[tuple[Dataset, float]] = []

    def fit(data: Dataset) -> Any:
        error = errors[min(len(seen), len(errors) - 1)]
        seen.append((data, error))
        return believing(error, 0.9 if believed else 0.1)

    data, _ = explored(Cart(), seed, most=150, fit=fit)
    before = float("inf")
    for i, (at, error) in enumerate(seen):
        rarer = min(int(at.succeeded.sum()), int((~at.succeeded).sum()))
        assert rarer >= FEWEST
        assert len(at.percept) >= LEAST
        settled = error <= GOOD or (before < float("inf") and error > GAIN * before)
        ends = settled and believed
        assert ends <= (i == len(seen) - 1)
        before = error
    last = seen[-1][0]
    assert len(last.percept) == len(data.percept)
    assert ends or len(data.percept) >= 150
    if not believed:
        assert len(data.percept) >= 150


def test_what_is_not_known_at_first_is_explored_until_it_is() -> None:
    """Success is met after a while only, and models are not fitted before."""
    domain = rail_with(succeeded=lambda self, state: state[:, PLACE] > 2.4)
    sizes: list[int] = []

    def fit(data: Dataset) -> Any:
        sizes.append(int(data.succeeded.sum()))
        return believing(0.1)

    data, _ = explored(domain, 3, most=400, fit=fit)
    assert len(sizes) == 1
    assert sizes[0] >= FEWEST
    assert len(data.percept) > 2 * FIRST


def test_motions_are_counted_until_one_succeeds() -> None:
    domain = rail_with(succeeded=lambda self, state: state[:, PLACE] > 2.4)
    told: list[tuple[str, int, int]] = []
    with listening(lambda *counts: told.append(counts)):
        explored(domain, 3, most=400, fit=fits(0.1))
    assert {(what, total) for what, _, total in told} == {("motions without success", 400)}
    done = [count for _, count, _ in told]
    assert done == sorted(done)
    assert done[:2] == [0, FIRST]
    assert FIRST < sorted(set(done))[-2] < 100  # and then it is over, with the first success
    assert done[-1] == 400


def test_what_is_counted_is_over_where_an_exploration_fails() -> None:
    told: list[int] = []
    with listening(lambda what, done, total: told.append(total - done)), pytest.raises(DataError):
        explored(rail_with(succeeded=lambda self, state: state[:, PLACE] > 1e9), most=30)
    assert told[-1] == 0


def stuck(self: Rail, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
    return lanes, torch.zeros(len(lanes), dtype=torch.bool)


@pytest.mark.parametrize(("share", "met"), [(0, 0), (1, 0), (0, 2)])
def test_where_there_is_nothing_to_learn_is_said(share: int, met: int) -> None:
    """Success is met always, never, or twice only."""
    rare = iter([True] * met)

    def succeeded(self: Rail, state: Tensor) -> Tensor:
        return torch.tensor([share == 1 or next(rare, False) for _ in state])

    said = rf"success was {('missed', 'met')[share]} in \d+ of \d+ tests of \d+ motions, and 3 of"
    advice = ("give .* nearer.*--models none", "is .*right.* farther from it")[share]
    with pytest.raises(DataError, match=f"{said} either result are needed; {advice}") as caught:
        explored(rail_with(succeeded=succeeded), most=30)
    assert "\n" not in str(caught.value)
    results, tests, motions, *_ = map(int, re.findall(r"\d+", str(caught.value)))
    assert results == tests - met == motions - met


def test_a_robot_that_never_moves_is_not_asked_for_ever() -> None:
    log = Log()
    domain = rail_with(step=stuck)
    with pytest.raises(DataError):
        models_of(domain).explore(about(domain, log=log, most=30))
    assert log.motions <= 30 + 30 // 2 + 2


def test_controls_that_cannot_be_carried_out_tell_nothing() -> None:
    class Blocked(Rail):
        def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
            after, _ = super().step(lanes, control)
            return after, control[:, 0] > 0

    domain, purse = cart_with(world=lambda self, scenarios: Blocked(scenarios)), Purse()
    data, log = explored(domain, most=40, fit=decaying(), purse=purse)
    assert (data.control[:, 0] > 0).all()
    assert log.motions > len(data.control)
    assert purse.total.motions == log.motions  # the robot has tried, and it took its time


def test_what_a_domain_calls_worth_trying_and_testing_is_what_is_tried_and_tested() -> None:
    def slow(self: Models[Cart], percept: Tensor, number: int, generator: Generator) -> Tensor:
        assert percept.shape == (4,)
        return 0.1 * random_controls(self.domain.control, number, generator)

    def near(self: Models[Cart], percept: Tensor) -> Tensor:
        return percept[:, PLACE].abs() < 1

    domain = cart_with(models=type("Own", (Models,), {"worth_trying": slow, "worth_testing": near}))
    data, _ = explored(domain, most=60, fit=decaying())
    assert (data.control.abs() <= 0.1 * torch.pi).all()
    assert (data.tested[:, PLACE].abs() < 1).all()
    assert torch.equal(data.tested, data.next_percept[data.next_percept[:, PLACE].abs() < 1])
    assert 0 < len(data.tested) < len(data.percept)
    none = {"worth_testing": lambda self, percept: torch.zeros(len(percept)) > 0}
    nowhere = cart_with(models=type("Own", (Models,), none))
    with pytest.raises(DataError, match=r"in 0 of 0 tests of \d+ motions"):
        explored(nowhere, most=30)


def chosen_plainly(domain: Cart, models: Any, percept: Tensor, generator: Generator) -> Tensor:
    """The control to try, one candidate at a time."""
    for _ in range(TRIES):
        drawn = models_of(domain).worth_trying(percept, CANDIDATES, generator)
        able = [u for u in drawn if bool(models_of(domain).possible(percept[None], u[None]))]
        if able:
            break
    else:
        return drawn[0]
    bold = float(torch.rand((), generator=generator)) < BOLD
    if models is None or not bold:
        return able[0]
    doubts = [
        abs(float(models.classifier(models.gamma(percept[None], u[None]))) - 0.5) for u in able
    ]
    return able[doubts.index(min(doubts))]


class CarefulModels(Models[Cart]):
    """It is pushed far only where its lamp looks ahead, and nowhere if it looks back."""

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        ahead = percept[:, LAMP].cos() > 0
        back = percept[:, LAMP].cos() < -0.9
        return (ahead | (control[:, 0].abs() < 0.05)) & ~back


class Careful(Cart):
    """One with these models."""

    models = CarefulModels


def curious() -> Any:
    models = believing(1.0)
    models.gamma = lambda percept, control: percept + 0.5 * control[:, :1]
    models.classifier = lambda percept: torch.sigmoid(2 - 2 * percept[:, PLACE])
    return models


@given(st.integers(0, 2**31), st.booleans(), st.booleans())
def test_most_motions_end_where_c_is_unsure(seed: int, fitted: bool, careful: bool) -> None:
    domain, models = Careful() if careful else Cart(), curious() if fitted else None
    percept = driven(1, 1, seed).percept[0]
    found = _chosen(models_of(domain), models, percept, about(domain, seed))
    generator = seeded(seed)
    assert torch.equal(found, chosen_plainly(domain, models, percept, generator)[None])


def test_the_generator_decides() -> None:
    first, again, other = (vars(explored(Cart(), seed)[0]) for seed in (1, 1, 2))
    assert all(torch.equal(rows, again[name]) for name, rows in first.items())
    assert not torch.equal(first["percept"], other["percept"])


@pytest.mark.parametrize("limits", [{"motions": 7}, {"actions": 20}, {"looks": 3}, {"tests": 0}])
def test_no_more_is_asked_than_the_budget_allows(limits: dict[str, float]) -> None:
    purse, log = Purse(limits), Log()
    with pytest.raises(BudgetSpentError):
        models_of(Cart()).explore(about(Cart(), log=log, purse=purse, fit=decaying()))
    ((name, limit),) = limits.items()
    assert getattr(purse.total, name) <= limit
    assert purse.total.motions == log.motions
    assert purse.total.tests == len(log.tested)


def test_models_of_what_was_explored_are_of_use() -> None:
    """Some thirty motions, instead of hundreds; trials of skills teach what is missing."""
    domain, fresh = SeeingCart(), driven(300, 300, 9)
    right, off, motions = list[float](), list[float](), list[int]()

    def fit(data: Dataset) -> Knowledge:
        return models_of(domain).fit(data, 0)

    for seed in (1, 2):
        data, log = explored(domain, seed, most=60, fit=fit)
        known = fit(data)
        with torch.no_grad():
            said = (known.classifier(fresh.tested) > 0.5) == fresh.succeeded
            error = known.gamma(fresh.percept, fresh.control) - fresh.next_percept
        right += [float(said[each].float().mean()) for each in (fresh.succeeded, ~fresh.succeeded)]
        off.append(float(error[:, PLACE].abs().mean()))
        motions.append(log.motions)
    still = float((fresh.percept - fresh.next_percept)[:, PLACE].abs().mean())
    assert sum(right) / len(right) > 0.6
    assert sum(off) / len(off) < 0.5 * still
    assert max(motions) < 45


class Ending(Tracked):
    """A world whose episodes are over far to the right, where nothing moves any more."""

    def over(self, lanes: Lanes) -> Tensor:
        return lanes.percept[:, 0] > 0


@pytest.mark.parametrize("lanes", [1, 3])
def test_nothing_is_tried_where_an_episode_is_over(lanes: int) -> None:
    log, generator, purse = Log(), seeded(1), Purse()

    def worlds(kind: str, number: int) -> Environment:
        return Recording(Ending(Cart().world(Cart().draw(kind, number, generator)), log), purse, "")

    how: dict[str, Any] = {"fit": fits(100.0), "most": 60, "lanes": lanes}
    start = Exploration("any", worlds, generator=generator, purse=purse, **how)
    found = models_of(Cart()).explore(start)
    over = [after for _, _, after in log.moved if after[0] > 0]
    assert len(over) > 3
    assert not any(torch.equal(before, end) for before, _, _ in log.moved for end in over)
    assert len(found.percept) == log.motions
    assert len(log.starts) > -(-log.motions // (CHAIN * lanes)), "others begin where all are over"
