import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from support import Counter, model, world
from torch import Generator, Tensor

from cgtorch.graphs import ActionSet, check_action, resolve_actions, reward_actions
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError
from cgtorch.tabletop.actions import paper_actions


def test_percepts_that_are_long_have_no_network_of_changes() -> None:
    """Every node of a population has room for the parameters of the largest action."""
    assert reward_actions(105, 8).names == ("Linear", "Aim", "Delay", "Recur", "Step", "Branch")
    large = reward_actions(348, 17)
    assert large.names == ("Linear", "Aim", "Recur", "Step", "Branch")
    assert max(action.num_parameters for action in large.actions) == 17 * 349


MODULE = """
import torch
from cgtorch.graphs import Action
from cgtorch.tabletop.actions import Detect

class Wave(Detect):
    outcomes = ("success", "tired")

class Sized(Detect):
    def __init__(self, size):
        super().__init__()

class Unfinished(Action):
    pass

class Holder:
    class Inner(Detect):
        pass

number = 3
"""


def resolved(names: Sequence[str] = ()) -> ActionSet:
    """What names stand for, beside the actions of the paper."""
    return resolve_actions(names, paper_actions(), (7, 3))


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package with actions of its own."""
    (tmp_path / "arm_actions.py").write_text(MODULE)
    (tmp_path / "broken_actions.py").write_text("raise RuntimeError('no\\nrobot')")
    info = tmp_path / "arm_actions-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: arm-actions\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[cgtorch.actions]\nwave = arm_actions:Wave\ngone = arm_actions:Gone\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("arm_actions", "broken_actions"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_the_papers_actions_are_always_there() -> None:
    five = paper_actions().names
    assert resolved().names == five
    assert resolved(["Grasp", "Detect", "Grasp"]).names == five


def test_entry_points_and_classes_are_added() -> None:
    names = ["wave", "arm_actions:Wave", "wave", "arm_actions:Holder.Inner"]
    actions = resolved(names)
    assert actions.names == (*paper_actions().names, "wave", "Wave", "Inner")
    assert actions.actions[5].outcomes == ("success", "tired")
    assert type(actions.actions[5]) is type(actions.actions[6])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Fly", "unknown action 'Fly'; known are Branch.*Base, RecurrentNN, gone, wave, or give"),
        ("", "unknown action ''"),
        ("gone", "cannot import action 'gone' .*no attribute 'Gone'"),
        ("none_such:Action", "cannot import action 'none_such:Action' .ModuleNotFoundError"),
        ("broken_actions:A", "cannot import action 'broken_actions:A' .RuntimeError: no robot"),
        ("arm_actions:Gone", "cannot import action 'arm_actions:Gone' .*no attribute 'Gone'"),
        ("arm_actions:", "cannot import action 'arm_actions:'"),
        (":Wave", "cannot import action ':Wave'"),
        ("arm actions:Wave", "cannot import action 'arm actions:Wave'"),
        ("arm_actions:number", "action 'arm_actions:number' is 3; give a subclass of Action"),
        ("arm_actions:Holder", "is <class 'arm_actions.Holder'>; give a subclass of Action"),
        ("arm_actions:torch", "is <module 'torch' .*; give a subclass of Action"),
        ("arm_actions:Sized", r"cannot be made as Sized\(\) .TypeError: .*'size'.* no arguments"),
        ("arm_actions:Unfinished", r"cannot be made as Unfinished\(\) .*abstract"),
        ("arm_actions:Detect", "'Detect' is used twice; names must be unique"),
    ],
)
def test_names_that_stand_for_nothing(name: str, message: str) -> None:
    with pytest.raises(ActionError, match=message) as caught:
        resolved([name])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("action", [*paper_actions().actions, Counter()])
def test_good_actions_pass_the_check(action: Any) -> None:
    for environment in (world(0, 3), world(0, 1), model(0, 2)):
        check_action("good", action, environment)


def forwarding(result: Callable[[Lanes], object]) -> type[Counter]:
    class Bad(Counter):
        def forward(
            self, lanes: Lanes, parameters: Tensor, environment: Environment
        ) -> tuple[Lanes, Tensor]:
            return result(lanes)  # type: ignore[return-value]

    return Bad


def in_place(lanes: Lanes) -> tuple[Lanes, Tensor]:
    lanes.memory[:, 0] += 1
    return lanes, torch.zeros(2, dtype=torch.long)


GOOD = torch.zeros(2, dtype=torch.long)


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda lanes: None, "forward returned a NoneType; return"),
        (lambda lanes: lanes, "forward returned a Lanes; return"),
        (
            lambda lanes: (GOOD, lanes),
            r"forward returned a tensor \(2,\) of int64 as lanes; return Lanes",
        ),
        (
            lambda lanes: (lanes, GOOD, 1),
            r"forward returned \(a Lanes, .*, a int\); return \(lanes,",
        ),
        (lambda lanes: (lanes, GOOD.float()), r"outcomes as a tensor \(2,\) of float32; return"),
        (lambda lanes: (lanes, GOOD[:1]), r"outcomes as a tensor \(1,\) of int64; return"),
        (lambda lanes: (lanes, 0), "outcomes as a int; return"),
        (lambda lanes: (lanes, GOOD + 3), r"returned outcomes \[3, 3\]; they index .* 0 to 2"),
        (lambda lanes: (lanes, GOOD - 1), r"returned outcomes \[-1, -1\]"),
        (
            lambda lanes: (replace(lanes, percept=lanes.percept[:, :6]), GOOD),
            r"lanes.percept as a tensor \(2, 6\) of float32; return a tensor \(2, 7\)",
        ),
        (
            lambda lanes: (lanes.rows(torch.tensor([0])), GOOD),
            r"lanes.percept as a tensor \(1, 7\) of float32; return a tensor \(2, 7\)",
        ),
        (
            lambda lanes: (replace(lanes, memory=lanes.memory.double()), GOOD),
            r"lanes.memory as a tensor \(2, 2\) of float64; return a tensor \(2, 2\) of float32",
        ),
        (
            lambda lanes: (replace(lanes, message=torch.zeros(2, 5)), GOOD),
            r"message as a tensor \(2, 5\) of float32; return .*, or set message_size in the",
        ),
        (
            lambda lanes: (replace(lanes, has_message=GOOD), GOOD),
            r"lanes.has_message as a tensor \(2,\) of int64; return a tensor \(2,\) of bool",
        ),
        (in_place, "forward changed lanes.memory in place; return new lanes"),
        (
            lambda lanes: replace(lanes, memories=lanes.memory),
            r"raised TypeError: .*'memories' in line \d+ of test_registry.py, tried with two rows",
        ),
        (
            lambda lanes: 1 / 0,
            r"raised ZeroDivisionError: division by zero in line \d+ of test_registry.py",
        ),
    ],
)
def test_what_forward_does_wrong_is_named(result: Callable[[Lanes], object], message: str) -> None:
    with pytest.raises(ActionError, match=f"action 'Bad': .*{message}"):
        check_action("Bad", forwarding(result)(), model(0, 2))


def twice(lanes: Lanes) -> tuple[Lanes, Tensor]:
    """What is right the first time only."""
    return replace(lanes, memory=lanes.memory + 1), GOOD + 3 * lanes.step.clamp_max(1)


def test_an_action_is_tried_at_later_visits_too() -> None:
    with pytest.raises(ActionError, match=r"returned outcomes \[3, 3\]"):
        check_action("Bad", forwarding(twice)(), model(0, 2))
    ends = forwarding(twice)
    ends.terminal = {ends.outcomes[0]: False}  # there is no second time
    check_action("Good", ends(), model(0, 2))


class Short(Counter):
    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        return torch.zeros(n, 1)


class NotFinite(Counter):
    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        return torch.full((n, 2), torch.nan)


class NoCount(Counter):
    num_parameters = -1


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (Short(), r"initial_parameters returned values as a tensor \(2, 1\).*tensor \(2, 2\)"),
        (NotFinite(), "initial_parameters returned numbers that are not finite"),
        (NoCount(), "num_parameters is -1; give a whole number"),
    ],
)
def test_wrong_parameters_are_named(action: Counter, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        check_action("Bad", action, model(0, 2))
