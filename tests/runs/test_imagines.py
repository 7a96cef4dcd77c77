"""Which models a run learns, and what does not go together with a Γ with rewards."""

from dataclasses import replace
from typing import Any

import pytest
from rewarded_cart import CartModels, RewardedCart

from cgtorch import DomainSettings, Models, RewardedModels
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.registry import make_domain
from cgtorch.ground.errors import SettingsError
from cgtorch.runs.imagines import check_imagined, check_played, models_of, reward_models_of
from cgtorch.runs.settings import RunSettings


def cart(models: Any) -> RewardedCart:
    return type("Own", (RewardedCart,), {"models": models})(DomainSettings())


class OwnModels(Models[Any]):
    """Γ and C of a domain that says more of them."""


@pytest.mark.parametrize(
    ("own", "models", "reward_models"),
    [
        (None, Models, RewardedModels),
        (OwnModels, OwnModels, RewardedModels),
        (CartModels, Models, CartModels),
    ],
)
def test_models_of_the_other_kind_are_the_default_ones(
    own: Any, models: type, reward_models: type
) -> None:
    domain = cart(own)
    assert type(models_of(domain)) is models
    assert type(reward_models_of(domain)) is reward_models
    assert reward_models_of(domain).domain is domain


def test_rewards_are_learned_where_a_domain_says_so_or_it_is_asked_for() -> None:
    auto = RunSettings(domain="own:Cart")
    check_imagined(auto, cart(CartModels), True)
    check_imagined(replace(auto, models="learned"), cart(None), True)
    check_imagined(replace(auto, models="learned"), cart(OwnModels), True)
    for models in (None, OwnModels):
        with pytest.raises(SettingsError, match=r"'own:Cart' gives rewards, which Γ and C do not"):
            check_imagined(auto, cart(models), True)


@pytest.mark.parametrize(
    ("given", "repeats", "says"),
    [
        ({"method": "paper"}, True, "method 'paper'"),
        ({"data": ("log.csv",)}, True, r"logged data \(--data\)"),
        ({}, False, "a world that does not repeat itself"),
        ({"method": "paper", "data": ("log.csv",)}, False, "method 'paper'"),
    ],
)
def test_what_a_model_of_rewards_does_not_go_with_is_named(
    given: dict[str, Any], repeats: bool, says: str
) -> None:
    with pytest.raises(SettingsError, match=f"is not learned with {says}; leave that out"):
        check_imagined(RunSettings(**given), cart(CartModels), repeats)


def test_rewards_for_models_are_refused_where_none_are_learned() -> None:
    check_played(RunSettings(), cart(None), True)
    domain = make_domain(
        "gymnasium:Pendulum-v1", GymnasiumSettings(target_return=-200.0, reward="own:reward")
    )
    with pytest.raises(SettingsError, match=r"reward is 'own:reward', which only learned models"):
        check_played(RunSettings(), domain, True)
