"""Acting at random: what Γ and C of any domain learn from."""

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rail import END, GEAR, LAMP, PLACE, WIND, Cart, Carts, Rail
from support import seeded
from torch import Generator, Tensor

from cgtorch.domains import Field
from cgtorch.domains.exploration import SHARE, random_controls
from cgtorch.environment import Dataset
from cgtorch.ground.errors import DataError, DomainError


def explored(seed: int, transitions: int = 100, tests: int = 80, **parts: Any) -> Dataset:
    """Of a cart of which some methods may be others."""
    own = type("Own", (Cart,), parts)()
    return own.explore("any", transitions, tests, seeded(seed))


@given(st.integers(0, 200), st.integers(0, 2**31))
def test_controls_are_within_the_bounds_of_their_fields(count: int, seed: int) -> None:
    found = random_controls(Cart.control, count, seeded(seed))
    assert found.shape == (count, 3)
    low, high = (torch.tensor([getattr(f, b) for f in Cart.control]) for b in ("low", "high"))
    assert ((found >= low) & (found <= high)).all()
    assert torch.equal(found[:, 2], found[:, 2].round())


def test_controls_are_uniform() -> None:
    found = random_controls(Cart.control, 30_000, seeded(0))
    assert found[:, 0].histc(4, -1, 1).div(30_000).tolist() == pytest.approx([0.25] * 4, abs=0.02)
    shares = [float((found[:, 2] == value).float().mean()) for value in (-1, 0, 1)]
    assert shares == pytest.approx([1 / 3] * 3, abs=0.02)


@pytest.mark.parametrize("bounds", [{"low": 0}, {"high": 0}, {}])
def test_a_control_without_bounds_is_named(bounds: dict[str, float]) -> None:
    control = (*Cart.control, Field("horn", **bounds))
    with pytest.raises(DomainError, match=r"control 'horn' has no bounds.*implement explore"):
        explored(0, control=control)


@settings(max_examples=15)
@given(st.integers(1, 300), st.integers(20, 900), st.integers(0, 2**31))
def test_there_are_as_many_as_asked_for_and_they_are_true(
    transitions: int, tests: int, seed: int
) -> None:
    data = explored(seed, transitions, tests)
    assert data.whole(4)
    assert len(data.percept) == transitions
    assert len(data.tested) == tests
    world = Rail(Cart().draw("any", 1, seeded(0)))
    after = world.next_state(data.percept, data.control, torch.zeros(0))
    assert torch.equal(after, data.next_percept)
    assert torch.equal(data.succeeded, world.succeeded(data.tested))
    rarer = min(int(data.succeeded.sum()), int((~data.succeeded).sum()))
    assert rarer >= int(SHARE * tests)


def test_carts_are_met_where_they_begin_and_where_they_come_to() -> None:
    data = explored(0, 500)
    assert data.percept[:, PLACE].abs().max() == END
    assert data.percept[:, WIND].abs().max() <= 0.25
    assert set(data.percept[:, GEAR].tolist()) == {0, 1, 2}
    assert data.percept[:, LAMP].histc(4, -torch.pi, torch.pi).min() > 80


def test_the_generator_decides() -> None:
    first, again, other = (vars(explored(seed)) for seed in (1, 1, 2))
    assert all(torch.equal(rows, again[name]) for name, rows in first.items())
    assert not torch.equal(first["percept"], other["percept"])


def stuck(self: Rail, lanes: Any, control: Tensor) -> Any:
    return lanes, torch.zeros(len(lanes), dtype=torch.bool)


def never(self: Rail, state: Tensor) -> Tensor:
    return state[:, 0] > END


def always(self: Rail, state: Tensor) -> Tensor:
    return state[:, 0] <= END


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"step": stuck}, "only 0 random controls could be carried out, and 100 are needed"),
        ({"succeeded": never}, "success was met in 0 of .* random tests, and 2 are needed"),
        ({"succeeded": always}, "success was missed in 0 of .* random tests, and 2 are needed"),
    ],
)
def test_where_there_is_nothing_to_learn_is_said(parts: dict[str, Any], message: str) -> None:
    kind = type("Track", (Rail,), parts)
    with pytest.raises(DataError, match=f"{message}.*--models none") as caught:
        explored(0, world=lambda self, scenarios: kind(scenarios))
    assert "\n" not in str(caught.value)


def test_controls_that_cannot_be_carried_out_tell_nothing() -> None:
    class Blocked(Rail):
        def step(self, lanes: Any, control: Tensor) -> Any:
            after, _ = super().step(lanes, control)
            return after, control[:, 0] > 0

    data = explored(0, world=lambda self, scenarios: Blocked(scenarios))
    assert len(data.control) == 100
    assert (data.control[:, 0] > 0).all()


def test_success_that_is_rare_is_looked_for() -> None:
    """It is met in few tests, and yet three of ten that are kept have it."""
    met: list[Tensor] = []

    def watched(self: Rail, state: Tensor) -> Tensor:
        met.append(Rail.succeeded(self, state))
        return met[-1]

    def far(self: Cart, kind: str, count: int, generator: Generator) -> Carts:
        drawn = Cart.draw(self, kind, count, generator)
        return Carts(2 + drawn.place.abs() / 2, drawn.wind, drawn.lamp, drawn.gear)

    kind = type("Track", (Rail,), {"succeeded": watched})
    data = explored(0, 100, 100, draw=far, world=lambda self, scenarios: kind(scenarios))
    assert float(torch.cat(met).float().mean()) < 0.1
    assert int(data.succeeded.sum()) == int(SHARE * 100)
