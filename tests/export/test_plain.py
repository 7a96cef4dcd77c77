"""The classes of state machines in plain Python, beside the actions that they stand for."""

import logging
import warnings
from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from driving import act, by_the_library
from hypothesis import given, settings
from hypothesis import strategies as st
from support import model, random_skill, recurrent_actions, seeded, stochastic_actions
from walking import chain

from cgtorch.export import (
    SkillStep,
    plain,
    to_dot,
    to_mermaid,
    to_module,
    to_state_machine,
)
from cgtorch.export.modules import _silence
from cgtorch.export.state_machine import memory_places, plain_arguments
from cgtorch.export.step import REQUESTS
from cgtorch.export.stepper import Request, Stepper
from cgtorch.graphs import Action, BranchingNN, ContinuousNN, DelayNN, LinearNN, RecurrentNN, Skill
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import ActionError, DataError, SettingsError
from cgtorch.tabletop.actions import paper_actions

NETWORKS: list[Action] = [
    ContinuousNN(), ContinuousNN(5, 2, 4), BranchingNN(), BranchingNN(4, 5), RecurrentNN(),
    RecurrentNN(5, 2, 1), DelayNN(), DelayNN(6, 2, 4), DelayNN(7, 1, 2), LinearNN(), LinearNN(4, 5),
]  # fmt: skip
NOTHING: Any = None


@pytest.mark.parametrize("number", range(len(NETWORKS)))
@given(seed=st.integers(0, 2**31 - 1))
@settings(max_examples=3)
def test_a_network_in_plain_numbers_says_what_the_library_s_says(number: int, seed: int) -> None:
    """Step after step, with an action before it that has a part of the memory, too."""
    action, before = NETWORKS[number], RecurrentNN(7, 2)
    places, size = memory_places([before, action])
    memory = places[id(action)]
    generator = seeded(seed)
    parameters = torch.randn(1, action.num_parameters, generator=generator, dtype=torch.float64)
    arguments = plain_arguments(action, memory)
    state = getattr(plain, type(action).__name__)(parameters[0].tolist(), **arguments)
    lanes = Lanes(
        torch.zeros(1, 7).double(), torch.zeros(1, 0), torch.full((1, 6), 9.0).double(),
        torch.tensor([False]), torch.zeros(1, size).double(), torch.tensor([0]), torch.tensor([0]),
    )  # fmt: skip
    userdata = plain.Userdata([], [9.0] * 6, memory=[0.0] * size)
    outcomes = set()
    for _ in range(6):
        percept = torch.randn(1, 7, generator=generator, dtype=torch.float64)
        userdata.percept = percept[0].tolist()
        own = slice(memory.start, memory.stop)
        seen = Lanes(percept, *list(vars(lanes.with_memory(own)).values())[1:])
        after, outcome = action(seen, parameters, NOTHING)
        lanes = Lanes(*{**vars(after), "memory": lanes.memory.clone()}.values())
        lanes.memory[:, own] = after.memory
        assert state.execute(userdata) == action.outcomes[int(outcome)]
        assert userdata.has_message == bool(lanes.has_message)
        assert userdata.message == pytest.approx(lanes.message[0].tolist(), abs=1e-9)
        assert userdata.memory == pytest.approx(lanes.memory[0].tolist(), abs=1e-9)
        outcomes.add(int(outcome))
    assert not state.asks(userdata)
    assert outcomes <= {0, 1}


def test_of_equal_branches_the_first_is_taken() -> None:
    state = plain.BranchingNN([0.0] * BranchingNN().num_parameters, 7, 3, 2)
    assert state.execute(plain.Userdata([1.0] * 7)) == "out1"


def test_the_logistic_function_stays_finite() -> None:
    assert plain.sigmoid(0) == 0.5
    assert plain.sigmoid(2) == pytest.approx(0.8807970779778823)
    assert plain.sigmoid(1e4) == 1
    assert 0 < plain.sigmoid(-1e4) == plain.sigmoid(-80) < 1e-30


def test_a_network_that_is_told_no_sizes_remembers_and_sends_nothing() -> None:
    data = plain.Userdata([1.0], [5.0], memory=[7.0])
    silent = plain.Network([], 3, memory=range(1))
    silent.send(data, [])
    silent.remember(data, [1.0, 2.0])
    plain.Network([], 3, 2, 1).remember(data, [3.0])
    assert (data.message, data.memory, data.has_message) == ([5.0], [7.0], True)


class Drive(plain.Step):
    """Notes what it is to carry out."""

    control_size = 2

    def step(self, userdata: plain.Userdata, *control: float) -> bool:
        userdata.percept = list(control)
        return control[0] > 0


def test_a_step_carries_out_the_message_if_that_is_a_control() -> None:
    userdata = plain.Userdata([0.0], [1.0, 2.0, torch.inf])
    assert not Drive().asks(userdata)  # as nothing has been sent
    assert Drive().execute(userdata) == "failure"
    assert userdata.percept == [0.0]
    userdata.has_message = True
    assert Drive().asks(userdata)
    assert Drive().execute(userdata) == "success"
    assert userdata.percept == [1, 2]
    userdata.message[0] = -1.0
    assert Drive().execute(userdata) == "failure"
    assert userdata.percept == [-1, 2]
    for wrong in (torch.nan, torch.inf):
        userdata.message[1] = wrong
        assert not Drive().asks(userdata)
        assert Drive().execute(userdata) == "failure"
        assert userdata.percept == [-1, 2]
    assert plain.Step().control(userdata) == [-1.0]  # one number, where it is not said


class Look(plain.Perceive):
    def perceive(self, userdata: plain.Userdata) -> Any:
        return (3.0, 4.0)


class Try(plain.Test):
    def test(self, userdata: plain.Userdata) -> bool:
        return userdata.percept[0] > 3


def test_a_robot_perceives_and_tests() -> None:
    userdata = plain.Userdata([4.0])
    assert Try().execute(userdata) == "success"
    assert Look().execute(userdata) == "success"
    assert userdata.percept == [3, 4]
    assert Try().execute(userdata) == "failure"
    for routine in (Look(), Try(), plain.Routine()):
        assert routine.asks(userdata)
    assert not plain.State().asks(userdata)


@pytest.mark.parametrize(
    ("run", "name"),
    [
        (lambda data: plain.State().execute(data), "State"),
        (lambda data: plain.Step().step(data), "Step.step"),
        (lambda data: plain.Perceive().perceive(data), "Perceive.perceive"),
        (lambda data: plain.Perceive().execute(data), "Perceive.perceive"),
        (lambda data: plain.Test().test(data), "Test.test"),
    ],
)
def test_what_is_not_filled_in_is_named(run: Any, name: str) -> None:
    with pytest.raises(NotImplementedError, match=f"^{name} is to be filled in$"):
        run(plain.Userdata([]))


def machine(name: str, *states: plain.State, most: int = 9, steps: int = 99) -> plain.StateMachine:
    """States that follow one another after a failure, and end the machine with a success."""
    made = plain.StateMachine(name, "0", most, steps)
    for number, state in enumerate(states):
        following = str((number + 1) % len(states))
        leads = {"success": "success", "failure": following, "again": following}
        made.add(str(number), state, leads)
    return made


class Counts(plain.State):
    """Succeeds when so many actions have been executed."""

    outcomes = ("again", "success")

    def execute(self, userdata: plain.Userdata) -> str:
        return "success" if userdata.steps >= self.parameters[0] else "again"


@pytest.mark.parametrize(
    ("enough", "most", "limit", "end", "steps"),
    [
        (0, 9, 99, "success", 1),
        (8, 9, 99, "success", 9),
        (9, 9, 99, "timeout", 9),
        (5, 9, 6, "success", 6),
        (6, 9, 6, "timeout", 6),
        (0, 9, 0, "timeout", 0),
    ],
)
def test_a_machine_ends_by_itself_or_runs_out(
    enough: int, most: int, limit: int, end: str, steps: int
) -> None:
    userdata = plain.Userdata([])
    made = machine("m", Counts([enough]), Counts([enough]), most=most, steps=limit)
    assert made.execute(userdata) == end
    assert userdata.steps == steps


def test_a_machine_in_a_machine_fails_when_it_runs_out() -> None:
    """And the actions in it are no transitions of the outer one."""
    userdata = plain.Userdata([])
    inner = machine("inner", Counts([7]), most=3)
    assert machine("outer", inner, most=3).execute(userdata) == "success"
    assert userdata.steps == 8
    userdata = plain.Userdata([])
    assert machine("outer", inner, most=2).execute(userdata) == "timeout"
    assert userdata.steps == 6


def driven(stepper: Stepper, environment: Environment, scenario: int) -> tuple[list[Any], str]:
    """What a stepper asks for in an environment, with its controls and outcomes, and the end."""
    lanes = start_lanes(environment, torch.tensor([scenario]), 3, 0)
    request, told = stepper.act(lanes.percept[0]), list[Any]()
    while not request.ended:
        control = torch.tensor(request.control or [0.0] * 3)
        lanes, out = act(request.kind, lanes, control, environment)
        told.append((request.kind, [round(x, 3) for x in control.tolist()], out))
        request = stepper.act(lanes.percept[0], out == 0)
    assert (request.action, request.control) == ("", ())
    return told, request.kind


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_stepper_asks_for_what_the_library_does(seed: int) -> None:
    """Networks that remember and actions in torch; the same stepper runs again and again."""
    skill, place = random_skill(seed, "S", recurrent_actions()), model(seed, 3)
    stepper = Stepper(skill)
    for scenario, run in enumerate(by_the_library(skill, place)[0]):
        wanted = [
            (kind, [round(x, 3) for x in control.tolist()], out)
            for kind, control, out in zip(run.routines, run.controls, run.outcomes, strict=True)
        ]
        assert driven(stepper, place, scenario) == (wanted, run.end)
        assert driven(stepper, place, scenario) == (wanted, run.end)


def test_a_request_tells_which_action_asks_and_for_what() -> None:
    graph = chain(paper_actions(), "ContinuousNN", "MoveBase", "Detect")
    skill = Skill("S", graph, paper_actions(), 3)
    stepper = Stepper(skill)
    first = stepper.act([1.0] * 7)
    assert (first.kind, first.action, len(first.control)) == ("control", "MoveBase", 3)
    assert not first.ended
    with pytest.raises(DataError, match="give 7 finite numbers"):
        stepper.act([1.0] * 6)
    assert stepper.act([1.0] * 7, done=False) == Request("perceive", "Detect")
    assert stepper.act([1.0] * 7) == Request("timeout")
    assert stepper.act([1.0] * 7) == first  # it begins anew
    assert Stepper(skill, max_steps=2).act([1.0] * 7) == first
    assert Stepper(skill, max_steps=1).act([1.0] * 7) == Request("timeout")


class Nosy(Action):
    """Moves by itself."""

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        return environment.step(lanes, lanes.message)


def test_after_an_error_a_stepper_begins_anew() -> None:
    actions = paper_actions().extended(["Nosy"], [Nosy()])
    stepper = Stepper(Skill("S", chain(actions, "Detect", "Nosy", "Grasp"), actions))
    for _ in range(2):
        assert stepper.act([0.0] * 7) == Request("perceive", "Detect")
        with pytest.raises(ActionError, match="asks its environment for 'step'"):
            stepper.act([0.0] * 7)


def test_a_control_that_is_none_fails_without_a_request() -> None:
    graph = chain(paper_actions(), "MoveBase", "Detect")
    stepper = Stepper(Skill("S", graph, paper_actions(), 3))
    assert stepper.act([]) == Request("perceive", "Detect")
    assert stepper.act([]) == Request("timeout")


def test_a_control_that_is_none_follows_the_edge_of_failure() -> None:
    """In a stepper, and in an exported step."""
    actions = paper_actions()
    graph = replace(
        chain(actions, "MoveBase", "Detect", "Grasp"),
        edges=torch.tensor([[[1, 2], [1, -1], [-1, 0]]]),
    )
    skill = Skill("S", graph, actions)
    assert Stepper(skill).act([]) == Request("test", "Grasp")
    step = SkillStep(skill, 7)
    assert REQUESTS[int(step(*step.first())[0])] == "test"


@pytest.mark.parametrize("seed", [0, 3])
def test_random_numbers_are_those_of_the_seed_s_scenario(seed: int) -> None:
    actions = stochastic_actions()
    graph = chain(actions, "Wander", "MoveBase")
    graph.parameters[0, 0, 0] = 1.0
    skill, place = Skill("S", graph, actions), model(0, 4)
    run = by_the_library(skill, place)[0][seed]
    stepper = Stepper(skill, seed) if seed else Stepper(skill)
    request = stepper.act(run.percepts[0])
    assert request.control == pytest.approx(run.controls[0].tolist())
    assert request.control != Stepper(skill, seed + 1).act(run.percepts[0]).control


def test_a_step_begins_with_nothing_and_says_what_it_needs() -> None:
    actions = recurrent_actions()
    skill = Skill("mine", chain(actions, "RecurrentNN", "MoveBase", "Grasp"), actions)
    step = SkillStep(skill)
    percept, outcome, place, mind = step.first()
    assert [len(x) for x in (percept, place, mind)] == [7, step.place_size, 4 + 1 + 22]
    assert not any(bool(x.any()) for x in (percept, outcome, place, mind))
    assert step.about() == {
        "format": "cgtorch-step",
        "version": 1,
        "skill": "mine",
        "percept": 7,
        "control": 3,
        "place": step.place_size,
        "mind": 27,
        "requests": ["success", "failure", "timeout", "MoveBase", "perceive", "Grasp"],
        "outcomes": {
            "MoveBase": ["success", "failure"],
            "perceive": ["success"],
            "Grasp": ["success", "failure"],
        },
    }


def test_torch_is_silent_for_a_while() -> None:
    before = logging.root.manager.disable

    def talk() -> None:
        assert logging.root.manager.disable == logging.WARNING
        warnings.warn("optional", stacklevel=1)
        raise KeyError

    with pytest.raises(KeyError), warnings.catch_warnings(record=True) as told, _silence():
        talk()
    assert not told
    assert logging.root.manager.disable == before


class Blind(Action):
    """Notes what it gets of the world."""

    met: ClassVar[list[Any]] = []

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        self.met.append((tuple(lanes.state.shape), lanes.scenario.tolist(), len(lanes)))
        return lanes, torch.zeros(len(lanes), dtype=torch.long)


def test_actions_of_ones_own_see_no_state_and_one_row() -> None:
    actions = paper_actions().extended(["Blind"], [Blind()])
    skill = Skill("S", chain(actions, "Blind", "Detect"), actions)
    Blind.met.clear()
    assert Stepper(skill).act([0.0] * 7) == Request("perceive", "Detect")
    step = SkillStep(skill, 7)
    step(*step.first())
    assert len(Blind.met) == 3  # one of them where the step is prepared
    assert Blind.met == [((1, 0), [0], 1)] * 3


def test_an_older_torch_is_told_to_be_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    skill = Skill("S", chain(paper_actions(), "Detect"), paper_actions())
    monkeypatch.delattr(torch, "while_loop")
    with pytest.raises(SettingsError, match=r"torch .* cannot export loops; install a newer one"):
        to_module(skill, 7)


def test_texts_end_with_a_line_break() -> None:
    skill = Skill("S", chain(paper_actions(), "Detect"), paper_actions())
    for write in (to_state_machine, to_dot, to_mermaid):
        data = write(skill)
        assert data.endswith(b"\n")
        assert not data.endswith(b"\n\n")
