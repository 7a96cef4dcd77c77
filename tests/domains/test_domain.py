"""What a domain's world can do, and which other worlds and measures it has."""

from typing import Any

import pytest
from rail import Cart, Rail, cart_with

from cgtorch.domains.domain import (
    counting,
    episodic,
    in_world,
    most_lanes,
    other_measures,
    rewarded,
)
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import SettingsError


def with_world(**parts: Any) -> Cart:
    kind = type("Track", (Rail,), parts)
    return cart_with(world=lambda self, scenarios: kind(scenarios))


def over(self: Rail, lanes: Lanes) -> Any:
    return lanes.step > 5


def test_a_world_is_known_by_what_it_has() -> None:
    kinds = (rewarded, counting, episodic)
    assert [kind(Cart()) for kind in kinds] == [False] * 3
    assert [kind(with_world(asked=Asked())) for kind in kinds] == [False, True, False]
    assert [kind(with_world(over=over)) for kind in kinds] == [False, False, True]
    returns = with_world(over=over, returns=over)
    assert [kind(returns) for kind in kinds] == [True, False, True]
    assert [most_lanes(each) for each in (Cart(), with_world(most_lanes=3))] == [None, 3]


def test_only_an_adaptable_domain_has_other_worlds_and_measures() -> None:
    with pytest.raises(SettingsError, match="Cart has one world only; leave world out"):
        in_world(Cart(), "moon")
    assert other_measures(Cart()) == {}
    other = Cart()
    adaptable = cart_with(
        for_run=over, variants=over, in_world=lambda self, name: (name, other),
        other_measures=lambda self: {"other": other},
    )  # fmt: skip
    assert in_world(adaptable, "moon") == ("moon", other)
    assert other_measures(adaptable) == {"other": other}
