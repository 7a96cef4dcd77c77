"""A domain is tried at the door, and the error says which method returned what."""

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import CartDriver, cart
from rail import Cart, Carts, Rail, SeeingCart, cart_with, rail_with
from support import seeded
from torch import Tensor

from cgtorch import Field
from cgtorch.domains import domain as domains
from cgtorch.domains.check import check_domain, check_sizes
from cgtorch.graphs import BranchingNN, Step
from cgtorch.ground.environment import Environment, Lanes, Rewarded, ScenarioBatch
from cgtorch.ground.errors import ActionError, DomainError, WorldError


def refused(domain: Cart, scenarios: str = "any") -> str:
    with pytest.raises(DomainError) as caught:
        check_domain(domain, scenarios)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("kind", [Cart, SeeingCart])
def test_good_domains_pass(kind: type[Cart]) -> None:
    assert check_domain(kind(), "any")


@pytest.mark.parametrize("name", ["percept", "control"])
@pytest.mark.parametrize("bad", [(), ("place", "wind"), None, 4, (Field("place"), "wind")])
def test_each_number_has_a_field(name: str, bad: object) -> None:
    message = refused(cart_with(**{name: bad}))
    assert message == f"Own.{name} is {bad!r:.60}; give a Field for each number"


def test_a_single_field_without_its_comma_is_told_so() -> None:
    assert refused(cart_with(percept=(Field("place")))).endswith(
        "give a Field for each number, in a tuple: a single one needs a comma, (field,)"
    )


def test_a_class_that_forgot_its_fields_is_told_so() -> None:
    class Blind(Cart):
        def __getattribute__(self, name: str) -> Any:
            if name == "percept":
                raise AttributeError(name)
            return super().__getattribute__(name)

    assert refused(Blind()) == "Blind.percept is None; give a Field for each number"


@pytest.mark.parametrize("name", ["percept", "control"])
def test_as_many_fields_as_the_world_has_numbers(name: str) -> None:
    fields = getattr(Cart, name)
    given, has = len(fields) - 1, len(fields)
    assert refused(cart_with(**{name: fields[1:]})) == (
        f"Own.{name} names {given} numbers, its world has {has}; give one Field for each"
    )


@pytest.mark.parametrize("bad", ["any", ["any"], ("any", 1), None])
def test_kinds_are_names_in_a_tuple(bad: object) -> None:
    assert refused(cart_with(kinds=bad)) == f"Own.kinds is {bad!r}; give names in a tuple"


@pytest.mark.parametrize("name", ["models", "pictures", "files"])
def test_parts_are_classes_of_their_kind(name: str) -> None:
    said = f"give a subclass of cgtorch.{name.title()}"
    more = " or cgtorch.RewardedModels, or None where no models are learned"
    said += more if name == "models" else ""
    assert refused(cart_with(**{name: "none"})) == f"Own.{name} is 'none'; {said}"
    assert said in refused(cart_with(**{name: int}))
    if name == "models":  # a domain may have none, as its skills are evolved in the world itself
        check_domain(cart_with(models=None), "any")
    else:
        assert said in refused(cart_with(**{name: None}))


@pytest.mark.parametrize("name", ["explore", "worth_trying", "success_features"])
def test_what_models_are_asked_is_not_left_aside_in_a_domain(name: str) -> None:
    said = f"Own has {name}, which is asked of its models; define it in a subclass of cgtorch.Model"
    assert refused(cart_with(**{name: lambda self, about: about})).startswith(said)


def test_there_is_a_kind_and_stages_are_about_such() -> None:
    assert refused(cart_with(kinds=())) == "Own.kinds is empty; name at least one kind of scenarios"
    assert refused(Cart(), "storm") == "Cart has no scenarios 'storm'; use one of any"
    check_domain(cart_with(stages={"one": "any"}), "any")
    message = refused(cart_with(stages={"one": "any", "two": "storm"}))
    assert message.startswith("Own.stages has 'two' about 'storm', which is none of its kinds")


class Alike(ScenarioBatch):
    """No dataclass, and not one scenario."""

    def __len__(self) -> int:
        return 1


def drawn(count: int, generator: Any) -> Carts:
    return Cart().draw("any", count, generator)


RETURNED = "Own.draw returned"
DRAWS: list[tuple[Callable[..., Any], str]] = [
    (lambda n, g: torch.rand(n, 4), rf"{RETURNED} a tensor \(0, 4\) of float32 for a count of 0; "),
    (lambda n, g: None, f"{RETURNED} a NoneType for a count of 0; return a ScenarioBatch of"),
    (lambda n, g: drawn(max(n, 1), g), f"{RETURNED} 1 scenarios for a count of 0; return a Scenar"),
    (lambda n, g: drawn(3 * n, g), f"{RETURNED} 6 scenarios for a count of 2; return a ScenarioB"),
    (lambda n, g: Alike(), f"{RETURNED} 1 scenarios for a count of 0; return"),
    (lambda n, g: drawn(n, torch.default_generator), "Own.draw gave other scenarios for the same "),
    (lambda n, g: [][n], "Own.draw raised IndexError.*tried with two rows"),
]


@pytest.mark.parametrize(("draw", "message"), DRAWS)
def test_what_draw_returns_wrongly_is_named(draw: Callable[..., Any], message: str) -> None:
    own = cart_with(draw=lambda self, kind, count, generator: draw(count, generator))
    assert re.fullmatch(f"{message}.*", refused(own))


def test_a_generator_that_is_left_alone_is_no_error() -> None:
    """Scenarios that are always the same are drawn from nothing."""
    same = Cart().draw("any", 8, seeded(0))
    check_domain(cart_with(draw=lambda self, kind, count, generator: same[:count]), "any")


def drawing(method: str) -> dict[str, Any]:
    """A method of a world that draws numbers by itself."""
    calls = itertools.count()

    def noisy(self: Rail, *given: Tensor) -> Tensor:
        known: Tensor = getattr(Rail, method)(self, *given)
        number = next(calls)
        return known ^ (number % 2 == 1) if known.dtype == torch.bool else known + number

    return {method: noisy}


METHODS = ["first_state", "next_state", "perceived", "succeeded"]


@pytest.mark.parametrize("method", METHODS)
def test_a_world_that_draws_numbers_by_itself_does_not_repeat_itself(method: str) -> None:
    assert check_domain(rail_with(**drawing(method)), "any") is False


@pytest.mark.parametrize("method", METHODS)
def test_one_that_gives_rewards_has_to_repeat_itself(method: str) -> None:
    own = rail_with(**drawing(method), over=over, returns=returns)
    message = refused(own)
    assert message.startswith("Own gives rewards, and its world gave something else when")
    assert message.endswith("Domain.draw, read no clock, and keep nothing of an earlier episode")


def test_a_domain_may_say_itself_that_nothing_repeats() -> None:
    """As where differences are too rare to be seen at the door."""
    assert check_domain(Cart(), "any") is True
    assert check_domain(cart_with(repeats=False), "any") is False
    rewarding = rail_with(over=over, returns=returns)
    assert check_domain(rewarding, "any") is True
    rewarding.repeats = False
    assert "gives rewards" in refused(rewarding)


def test_a_robot_is_asked_nothing(tmp_path: Path) -> None:
    driver = CartDriver()
    domain = cart(tmp_path / "log", driver)
    assert check_domain(domain, "near") is False
    assert not driver.calls
    assert not (tmp_path / "log").exists()
    with pytest.raises(DomainError, match="has no scenarios 'storm'; use one of near, far"):
        check_domain(domain, "storm")


def test_a_world_that_fails_where_it_has_moved_is_named() -> None:
    def succeeded(self: Rail, state: Tensor) -> Tensor:
        begun = torch.equal(state, self.first_state(torch.arange(len(state))))
        return Rail.succeeded(self, state if begun else state[:, 9])

    with pytest.raises(WorldError, match=r"Track raised IndexError: .* in line \d+ of test_check"):
        check_domain(rail_with(succeeded=succeeded), "any")


def test_a_world_that_cannot_be_made_is_named() -> None:
    own = cart_with(world=lambda self, scenarios: Rail(scenarios.track))
    assert refused(own).startswith("Own.world raised AttributeError: ")


RESULTS: list[tuple[str, Callable[..., Any], str]] = [
    ("start", lambda s: s, r"start \(.*\) returned a tensor \(2,\) of int64; return \(states"),
    ("step", lambda lanes, u: lanes, r"step \(.*\) returned a Lanes; return \(lanes, whe"),
    ("success", lambda lanes: None, r"success \(.*\) returned a NoneType; return \(lanes"),
    ("first_state", lambda s: [][1], r"start \(first_state, perceived\) raised IndexError"),
    ("first_state", lambda s: s, r"start .* percepts as a tensor \(2,\) of float32; .*\(2, 1\)"),
    ("perceived", lambda x, s: x[:, None], r"start .* percepts as a tensor \(2, 1, 4\).*\(2, 4\)"),
    ("next_state", lambda x, u, s: x @ x, r"step \(next_state, perceived\) raised RuntimeError"),
    (
        "succeeded",
        lambda x: x < 0.5,
        r"success \(succeeded\) .* probabilities .* \(2, 4\)",
    ),
    (
        "succeeded",
        lambda x: x[:, 0].abs(),
        r"succeeded returned .* \(2,\) of float32; .*bool",
    ),
]


@pytest.mark.parametrize(("method", "result", "message"), RESULTS)
def test_what_a_world_returns_wrongly_is_named(
    method: str, result: Callable[..., Any], message: str
) -> None:
    own = rail_with(**{method: lambda self, *given: result(*given)})
    with pytest.raises((WorldError, DomainError), match=rf"Track\.{message}"):
        check_domain(own, "any")


def pushed(state: Tensor, control: Tensor) -> Tensor:
    return torch.cat([state[:, :1] + control[:, :1].clamp(-1, 1), state[:, 1:]], 1)


def centred(self: Environment, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
    after = pushed(state, control)
    return after - after.mean(0)


def at_times(self: Environment, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
    """What the first row decides for all."""
    return state if state[0, 0] > 0 and control[0, 0] > 0 else pushed(state, control)


def each(self: Environment, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
    stays = (state[:, :1] > 0) & (control[:, :1] > 0)
    return torch.where(stays, state, pushed(state, control))


@pytest.mark.parametrize("wrong", [centred, at_times])
def test_what_depends_on_other_rows_is_told(wrong: Callable[..., Any]) -> None:
    told = refused(rail_with(next_state=wrong))
    assert told.startswith("Own's world showed something else for a scenario alone than for the sa")
    assert re.search(
        r"number \d of the percept after motion \d+: \S+ and \S+\); let each row", told
    )
    check_domain(rail_with(next_state=each), "any")


@pytest.mark.parametrize(
    ("method", "result", "told"),
    [
        ("first_state", lambda s: s - s.mean(0), "number 1 of the first percept: 0.0 and "),
        ("succeeded", lambda s: s[:, 0] > s[:, 0].mean(), "success after motion 1: 0.0 and 1.0"),
    ],
)
def test_each_method_is_tried_with_a_row_alone(
    method: str, result: Callable[[Tensor], Tensor], told: str
) -> None:
    def own(self: Rail, given: Tensor) -> Tensor:
        return result(Rail.first_state(self, given) if method == "first_state" else given)

    assert told in refused(rail_with(**{method: own}))


def test_what_returns_are_made_of_is_tried_with_a_row_alone() -> None:
    def shared(self: Environment, lanes: Lanes) -> Tensor:
        return lanes.state[:, 0] / len(lanes)

    assert "alone" in refused(rail_with(over=over, returns=shared))


def test_a_row_alone_keeps_its_dimension() -> None:
    flat = rail_with(succeeded=lambda self, state: state[:, :1].squeeze() > 0)
    with pytest.raises(
        WorldError,
        match=r"success after motion 1 in a tensor \(\) of float32 for one row, in a tensor \(8,",
    ):
        check_domain(flat, "any")
    fails = rail_with(succeeded=lambda self, state: (state[1, 0], state[:, 0] > 0)[1])
    with pytest.raises(WorldError, match=r"raised IndexError: .*tried with one row"):
        check_domain(fails, "any")


def test_what_is_no_environment_is_refused() -> None:
    own = cart_with(world=lambda self, scenarios: scenarios)
    with pytest.raises(WorldError, match="Carts: num_scenarios is None; give a whole number"):
        check_domain(own, "any")


def test_actions_are_a_set() -> None:
    assert refused(cart_with(actions=lambda self: ("Aim",))) == (
        "Own.actions returned (a str); return an ActionSet"
    )
    assert "Own.actions raised KeyError" in refused(cart_with(actions=lambda self: {}["x"]))


def over(self: Environment, lanes: Lanes) -> Tensor:
    return lanes.step > 5


def returns(self: Environment, lanes: Lanes) -> Tensor:
    return -lanes.state[:, 0].abs()


def test_rewards_are_tried() -> None:
    rewarded = rail_with(over=over, returns=returns)
    assert isinstance(rewarded.world(rewarded.draw("any", 1, seeded(0))), Rewarded)
    assert domains.rewarded(rewarded)
    assert "Test" not in rewarded.actions().names
    check_domain(rewarded, "any")
    bad = rail_with(over=lambda self, lanes: lanes.step, returns=returns)
    assert refused(bad) == (
        "Own's world.over returned a tensor (2,) of int64; return a tensor (2,) of bool"
    )
    bad = rail_with(over=over, returns=lambda self, lanes: lanes.state)
    assert refused(bad) == (
        "Own's world.returns returned a tensor (2, 4) of float32; return a tensor (2,) of floats"
    )
    bad = rail_with(over=over, returns=lambda self, lanes: 0.5)
    assert "world.returns returned a float; return a tensor (2,)" in refused(bad)
    bad = rail_with(over=lambda self, lanes: {}[0], returns=returns)
    assert "Own's world.over raised KeyError: 0 in line " in refused(bad)


def test_noise_is_known_by_its_method() -> None:
    class Gusts(Carts):
        def with_noise(self, copy: int) -> Any:
            return replace(self, wind=self.wind + copy)

    def draw(self: Cart, kind: str, count: int, generator: torch.Generator) -> Gusts:
        return Gusts(*vars(Cart.draw(self, kind, count, generator)).values())

    assert not domains.noisy(Cart())
    assert domains.noisy(cart_with(draw=draw))


def test_an_action_for_other_numbers_is_named() -> None:
    check_sizes("Look", BranchingNN(4), 4, 3)
    check_sizes("Push", Step(3), 4, 3)
    with pytest.raises(ActionError, match="'Look' reads 5 numbers, and a percept has 4; make it"):
        check_sizes("Look", BranchingNN(5), 4, 3)
    with pytest.raises(ActionError, match=r"'Push' sends 2 numbers .* has 3; make it as Step\(3\)"):
        check_sizes("Push", Step(2), 4, 3)
