"""What is plugged in is checked at the door, and the error says which method returned what."""

import json
import traceback
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import pytest
import torch
from reaching import unrepeatable
from support import Counter, custom_actions, model, nested_actions, seeded, world
from torch import Tensor

from cgtorch.evolution import EvolutionSettings, evolve
from cgtorch.graphs import to_networkx
from cgtorch.ground.dry_run import (
    MOTIONS,
    check_default_type,
    check_environment,
    failed_at,
    kind,
    reason,
    two_rows,
    what_differs,
    what_is_shared,
)
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, DomainError, ModelError, WorldError
from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios

SETTINGS = EvolutionSettings(population=8, capacity=8, initial_nodes=(2, 6))
PERCEPTS = torch.rand(5, 7, generator=torch.Generator().manual_seed(0))
ROWS = torch.tensor([0, 1])


class Plain:
    """A domain of one's own: points on a line, in two numbers."""

    num_scenarios: Any = 3
    percept_size: Any = 2
    control_size: Any = 1

    def start(self, scenario: Tensor) -> Any:
        return scenario[:, None].float(), torch.stack([scenario.float(), -scenario.float()], 1)

    def step(self, lanes: Lanes, control: Tensor) -> Any:
        return replace(lanes, percept=lanes.percept + control), control[:, 0] < 1

    def observe(self, lanes: Lanes) -> Any:
        return lanes

    def success(self, lanes: Lanes) -> Any:
        return lanes, torch.sigmoid(lanes.percept[:, 0])


class Blind(Plain):
    """Percepts that are no numbers, and no success."""

    def start(self, scenario: Tensor) -> Any:
        state, percept = super().start(scenario)
        return state, percept * torch.nan

    def success(self, lanes: Lanes) -> Any:
        return lanes, torch.zeros(len(lanes))


def test_good_environments_pass() -> None:
    own: Environment = Plain()
    double = torch.float64
    for environment in (own, world(0, 1), world(0, 4), model(0, 1), model(0, 3, dtype=double)):
        check_environment(environment)
    Plain.num_scenarios = 1
    check_environment(own)
    Plain.num_scenarios = 3


@pytest.mark.parametrize("method", ["start", "step", "success"])
@pytest.mark.parametrize("late", [False, True])
def test_what_differs_when_it_is_asked_again_does_not_repeat_itself(
    method: str, late: bool
) -> None:
    """Whichever method draws the numbers, and in whichever of its results they are seen."""
    calls = count()

    def drawn(self: Any, *given: Any) -> Any:
        one, two = getattr(Plain, method)(self, *given)
        odd = next(calls) % 2
        if method == "start":
            return one, two + odd
        if method == "step":
            if late:
                return one, two ^ (odd == 1)
            return replace(one, percept=one.percept + odd), two
        return one, two * (1 - odd / 2)

    assert not what_differs(Plain())
    assert what_differs(type("Own", (Plain,), {method: drawn})())
    assert not what_differs(world(0, 3))
    assert not what_differs(model(0, 3))
    assert what_differs(unrepeatable(random_scenarios("near", 3, seeded(0))))


def test_what_is_no_number_twice_is_the_same() -> None:
    assert not what_differs(Blind())


def doubled(lanes: Lanes) -> Lanes:
    return replace(lanes, percept=lanes.percept.double())


def in_place(lanes: Lanes) -> Lanes:
    lanes.percept[:, 0] += 1
    return lanes


@pytest.mark.parametrize(
    ("method", "result", "message"),
    [
        ("start", lambda s: s.float(), r"a tensor \(2,\) of float32; return \(states"),
        ("start", lambda s: (s[:, None], s), r"percepts as a tensor \(2,\) of int64; .* \(2, 2\)"),
        ("start", lambda s: (s, torch.zeros(2, 2)), r"states as a tensor \(2,\) of.*\(2, S\)"),
        ("start", lambda s: (s[:1, None], torch.zeros(1, 2)), r"\(1, 2\) of float32; .*\(2, 2\)"),
        ("start", lambda s: {}["x"], r"raised KeyError: 'x' in line \d+ of test_dry_run.py, tried"),
        ("step", lambda lanes, u: lanes, r"step returned a Lanes; return \(lanes, whether"),
        ("step", lambda lanes, u: (lanes, u[:, 0]), r"be done as a tensor \(2,\) .* of bool"),
        ("step", lambda lanes, u: (doubled(lanes), u[:, 0] < 1), r"\(2, 2\) of float64; .*float32"),
        ("step", lambda lanes, u: (lanes.rows(ROWS[:1]), u[:, 0] < 1), r"as a tensor \(1, 2\)"),
        ("step", lambda lanes, u: (in_place(lanes), u[:, 0] < 1), "changed lanes.percept in place"),
        ("step", lambda lanes, u: u @ u, "Own.step raised RuntimeError.*tried with two rows"),
        ("observe", lambda lanes: lanes.percept, r"a tensor \(2, 2\) of float32 as lanes; return"),
        ("observe", lambda lanes: in_place(lanes), "changed lanes.percept in place"),
        (
            "observe",
            lambda lanes: replace(lanes, memory=torch.zeros(2, 3)),
            r"lanes.memory as a tensor \(2, 3\) of float32; return a tensor \(2, 0\) of float32, "
            "or set memory_size in the action's class",
        ),
        (
            "observe",
            lambda lanes: replace(lanes, message=torch.zeros(2, 3)),
            r"as a tensor \(2, 3\) of float32; return a tensor \(2, 1\) .* set message_size in",
        ),
        ("observe", lambda lanes: replace(lanes, step=1), "step as a int; return a tensor"),
        ("success", lambda lanes: (lanes,), r"success returned \(a Lanes\); return \(lanes, prob"),
        (
            "success",
            lambda lanes: (lanes, -lanes.percept[:, 0] - 1),
            r"\[-1.0, -2.0\]; return prob",
        ),
        ("success", lambda lanes: 0.5, r"success returned a float; return \(lanes, prob"),
        ("success", lambda lanes: lanes.percept[:, 0], r"success returned a tensor \(2,\)"),
        ("success", lambda lanes: (in_place(lanes), lanes.percept[:, 0]), "changed lanes.percept"),
        ("success", lambda lanes: (lanes, lanes.percept), r"probabilities as a tensor \(2, 2\)"),
        ("success", lambda lanes: (lanes, lanes.has_message), r"\(2,\) of bool; return"),
        ("success", lambda lanes: (lanes, 2 + lanes.percept[:, 0]), r"\[2.0, 3.0\]; return prob"),
    ],
)
def test_what_a_method_returns_wrongly_is_named(
    method: str, result: Callable[..., object], message: str
) -> None:
    own = type("Own", (Plain,), {method: lambda self, *given: result(*given)})()
    with pytest.raises(WorldError, match=message) as caught:
        check_environment(own)
    assert str(caught.value).startswith(f"Own.{method} ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["num_scenarios", "percept_size", "control_size"])
@pytest.mark.parametrize("bad", [0, -1, 2.0, None, "3"])
def test_sizes_are_whole_numbers(name: str, bad: object) -> None:
    own = type("Own", (Plain,), {name: bad})()
    with pytest.raises(WorldError, match=f"Own: {name} is {bad!r}; give a whole number"):
        check_environment(own)


def made(**changed: Any) -> ModelEnvironment:
    parts: dict[str, Any] = {
        "percepts": PERCEPTS,
        "gamma": lambda p, u: (p, p[:, 0]),
        "classifier": lambda p: p[:, 0],
        "possible": lambda p, u: p[:, 0] > 0,
    }
    return ModelEnvironment(**{**parts, **changed})


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("gamma", lambda p, u: p, r"Γ returned a tensor \(2, 7\) .*; return \(next percepts, nov"),
        (
            "gamma",
            lambda p, u: (p[:, :6], p[:, 0]),
            r"percepts as a tensor \(2, 6\) .*\(2, 7\)",
        ),
        ("gamma", lambda p, u: (p.double(), p[:, 0]), r"\(2, 7\) of float64; return .* of float32"),
        (
            "gamma",
            lambda p, u: (p, p),
            r"returned novelty as a tensor \(2, 7\) .*return .*\(2,\)",
        ),
        ("gamma", lambda p, u: p @ u, r"Γ raised RuntimeError.*tried with two rows"),
        ("classifier", lambda p: p > 0, r"C returned a tensor \(2, 7\) of bool; return .*\(2,\)"),
        ("classifier", lambda p: None, r"C returned a NoneType; return a tensor \(2,\) of float32"),
        ("possible", lambda p, u: p[:, 0], r"possible returned a tensor \(2,\) of float32; .*bool"),
        ("percepts", PERCEPTS[0], r"percepts are a tensor \(7,\) of float32; give .*\(B, D\)"),
        ("percepts", PERCEPTS.long(), r"percepts are a tensor \(5, 7\) of int64; give"),
        ("errors", torch.zeros(5, 7), r"errors of Γ are a tensor \(5, 7\) .*; give \(B, T, D\)"),
        ("errors", torch.zeros(4, 2, 7), r"errors of Γ are a tensor \(4, 2, 7\)"),
        ("errors", torch.zeros(5, 0, 7), r"errors of Γ are a tensor \(5, 0, 7\)"),
        ("errors", torch.zeros(5, 2, 7).long(), r"\(5, 2, 7\) of int64; give"),
    ],
)
def test_models_are_tried_where_they_are_put_together(
    part: str, value: object, message: str
) -> None:
    made(errors=torch.zeros(5, 2, 7))
    with pytest.raises(ModelError, match=message) as caught:
        made(**{part: value})
    assert "\n" not in str(caught.value)


class Silent(Counter):
    """An action that returns no control."""

    def forward(self, lanes: Lanes, parameters: Tensor, environment: Environment) -> Any:
        return lanes


def test_evolve_is_a_door() -> None:
    """Nothing is evaluated before what it is given has been tried."""
    bad = type("Own", (Plain,), {"success": lambda self, lanes: lanes.percept})()
    silent = paper_actions().extended(["Silent"], [Silent()])
    with pytest.raises(WorldError, match=r"Own\.success returned"):
        next(evolve(bad, paper_actions(), SETTINGS, seeded(0)))
    with pytest.raises(ActionError, match="action 'Silent': forward returned a Lanes"):
        next(evolve(model(0, 3), silent, SETTINGS, seeded(0)))
    for actions in (custom_actions(), nested_actions()):
        next(evolve(model(0, 3), actions, SETTINGS, seeded(0)))


def test_what_was_returned_is_described() -> None:
    assert kind(torch.zeros(2, 3)) == "a tensor (2, 3) of float32"
    assert kind((torch.tensor(1), None)) == "(a tensor () of int64, a NoneType)"
    assert kind(((), (1, 2, 3, 4))) == "((), (a int, a int, a int, a int))"
    assert kind((1, 2, 3, 4, 5)) == "a tuple"


class WordlessError(Exception):
    def __str__(self) -> str:
        raise ValueError("no words")


def test_the_reason_is_one_short_line() -> None:
    assert reason(KeyError("x")) == "KeyError: 'x'"
    assert reason(ValueError("a\n  b" + 300 * "c")) == f"ValueError: a b{197 * 'c'}"
    assert reason(ValueError()) == "ValueError"
    assert reason(WordlessError()) == "WordlessError"


def own_line(e: BaseException) -> int:
    """The line in which this file was left."""
    return [f.lineno for f in traceback.extract_tb(e.__traceback__) if f.filename == __file__][-1]


def test_where_it_failed_is_the_users_line_and_not_the_librarys() -> None:
    nothing: Any = None
    errors = AttributeError, ValueError, RuntimeError
    for failing in (
        lambda: to_networkx(nothing, nothing),  # of the library
        lambda: json.loads("nonsense"),  # of Python
        lambda: torch.nn.Linear(2, 3)(torch.zeros(5)),  # of a package
    ):
        with pytest.raises(errors) as caught:
            failing()
        assert failed_at(caught.value) == f" in line {own_line(caught.value)} of test_dry_run.py"
    assert failed_at(ValueError("never raised")) == ""
    where = eval("lambda: 1 / 0")  # noqa: S307  a text, which has no file
    with pytest.raises(ZeroDivisionError) as caught:
        where()
    assert failed_at(caught.value) == f" in line {own_line(caught.value)} of test_dry_run.py"


def test_two_rows_are_tried_of_as_many_as_there_are() -> None:
    assert two_rows(1).tolist() == [0, 0]
    assert two_rows(2).tolist() == two_rows(9).tolist() == [0, 1]


def test_what_a_check_begins_with_has_a_message_and_no_memory() -> None:
    met = list[tuple[Any, ...]]()

    def step(self: Any, lanes: Lanes, control: Tensor) -> Any:
        met.append((*lanes.message.shape, *lanes.memory.shape, lanes.scenario.tolist()))
        assert not control.any()
        return Plain.step(self, lanes, control)

    own = type("Own", (Plain,), {"step": step})()
    check_environment(own)
    assert not what_differs(own)
    assert met == [(2, 1, 2, 0, [0, 1])] * (1 + 2 * MOTIONS)


def test_percepts_that_are_no_numbers_are_not_taken_for_changed_ones() -> None:
    def seeing(self: Any, lanes: Lanes) -> Any:
        lanes.percept[:] = 0
        return lanes

    check_environment(Blind())
    bad = type("Own", (Blind,), {"observe": seeing})()
    with pytest.raises(WorldError, match=r"changed lanes\.percept in place"):
        check_environment(bad)


def test_rewards_that_differ_when_they_are_asked_again_do_not_repeat_themselves() -> None:
    calls = count()

    class Paid(Plain):
        def over(self, lanes: Lanes) -> Tensor:
            return torch.zeros(len(lanes), dtype=torch.bool)

        def returns(self, lanes: Lanes) -> Tensor:
            return lanes.percept[:, 0]

    class Lucky(Paid):
        def returns(self, lanes: Lanes) -> Tensor:
            return lanes.percept[:, 0] + next(calls)

    assert not what_differs(Paid())
    assert what_differs(Lucky())


def test_what_differs_is_named_with_the_step_and_both_values() -> None:
    class Drifting(Plain):
        drift = 0.0

        def step(self, lanes: Lanes, control: Tensor) -> Any:
            Drifting.drift += 1
            seen = lanes.percept + torch.tensor([0, Drifting.drift])
            return replace(lanes, percept=seen), control[:, 0] < 1

    assert what_differs(Drifting()) == "number 2 of the percept after motion 1: 1.0 and 4.0"


def test_scenarios_that_share_a_state_show_it_when_they_begin_in_another_order() -> None:
    class Sharing(Plain):
        last = 0.0

        def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
            Sharing.last = float(scenario[-1])
            return super().start(scenario)

        def step(self, lanes: Lanes, control: Tensor) -> Any:
            seen = torch.full_like(lanes.percept, Sharing.last)
            return replace(lanes, percept=seen), control[:, 0] < 1

    assert not what_differs(Sharing())
    assert what_is_shared(Sharing()) == "number 1 of the percept after motion 1: 1.0 and 0.0"
    assert not what_is_shared(Plain())
    assert not what_is_shared(world(0, 3))


def test_another_default_type_of_torch_is_told() -> None:
    torch.set_default_dtype(torch.float64)
    try:
        with pytest.raises(DomainError, match=r"is torch\.float64, as Own or your .*dtype="):
            check_default_type("Own")
    finally:
        torch.set_default_dtype(torch.float32)
    check_default_type("Own")


def test_what_an_environment_is_made_of_is_named_in_its_place() -> None:
    parts = {"step": "move", "success": "won"}
    wrong = {"step": lambda self, lanes, control: lanes, "made_of": parts}
    with pytest.raises(WorldError, match=r"^Own\.move returned a Lanes"):
        check_environment(type("Own", (Plain,), wrong)())
    wrong = {"success": lambda self, lanes: lanes, "made_of": parts}
    with pytest.raises(WorldError, match=r"^Own\.won returned a Lanes"):
        check_environment(type("Own", (Plain,), wrong)())
