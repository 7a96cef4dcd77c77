"""A skill that acts step by step; `tests/simulation/reference.py` compares it with rollouts."""

import copy
import pickle
from dataclasses import replace
from typing import Any

import pytest
import torch
from reaching import world_of
from support import Counter, random_graphs, random_skill, seeded
from walking import chain, walking_actions

from cgtorch.export import FORMATS
from cgtorch.export.step import SkillStep
from cgtorch.export.stepper import Request, Stepper
from cgtorch.graphs import Action, ActionSet, Perceive, Skill, Step, SubSkill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, DataError, SettingsError
from cgtorch.report import draw_skill
from cgtorch.simulation.rollout import most_steps, rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios


class Nosy(Action):
    """Moves by itself."""

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        return environment.step(lanes, lanes.message)


def test_what_a_robot_does_not_have_is_named() -> None:
    actions = paper_actions().extended(["Nosy"], [Nosy()])
    many = random_graphs(0, 99, actions)
    starts = many.action.gather(1, many.start[:, None])[:, 0]
    graph = many[(starts == actions.index("Nosy")).nonzero()[:1, 0]]
    with pytest.raises(ActionError, match="asks its environment for 'step'"):
        Stepper(Skill("nosy", graph, actions)).act([0.0] * 7)


ZEROS = torch.zeros(7)


@pytest.mark.parametrize(
    "percept",
    [
        [[0.0] * 7],
        1.0,
        ["far"],
        "1234567",
        b"1234567",
        {*range(7)},
        dict.fromkeys(range(7)),
        [10**400, *[0.0] * 6],
        [10**5000, *[0.0] * 6],
        ZEROS.to_sparse(),
        ZEROS.to("meta"),
        ZEROS[None],
    ],
)
def test_what_is_no_row_is_no_percept(percept: Any) -> None:
    with pytest.raises(DataError, match=r"percept is .*; give one row of numbers"):
        Stepper(random_skill(0, "S", paper_actions())).act(percept)


def test_a_percept_has_as_many_numbers_as_the_networks_read() -> None:
    stepper = Stepper(random_skill(0, "S", paper_actions()))
    for row in (ZEROS.tolist(), ZEROS, ZEROS.numpy(), (*ZEROS,)):
        stepper.act(row)
    for wrong in ([0.0] * 6, [0.0] * 8, [0.0] * 9, [0.0] * 14, [torch.nan, *[0.0] * 6]):
        with pytest.raises(DataError, match="numbers; give 7 finite numbers"):
            stepper.act(wrong)
    alone = ActionSet(("Detect",), (Perceive(),))
    for size in (0, 5):  # where nothing reads it
        Stepper(Skill("S", chain(alone, "Detect"), alone)).act([0.0] * size)


def pickled(stepper: Stepper) -> Any:
    return pickle.loads(pickle.dumps(stepper))  # noqa: S301  it is one's own


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_a_stepper_is_copied_between_episodes_only(copied: Any) -> None:
    actions = paper_actions()
    stepper = Stepper(Skill("S", chain(actions, "Detect"), actions, 2))
    for _ in range(2):
        other = copied(stepper)
        assert stepper.act(ZEROS) == other.act(ZEROS) == Request("perceive", "Detect")
        with pytest.raises(SettingsError, match="is within an episode, which cannot be copied"):
            copied(stepper)
        assert [stepper.act(ZEROS).kind for _ in range(2)] == ["perceive", "timeout"]
        assert [other.act(ZEROS).kind for _ in range(2)] == ["perceive", "timeout"]


def test_a_sub_skill_may_begin_after_more_actions_than_it_could_make() -> None:
    """Of all skills only the outermost limits the actions on all levels."""
    actions = paper_actions()
    long = Skill("long", chain(actions, "Detect"), actions, 45)
    short = Skill("short", chain(actions, "Detect", "Detect"), actions, 2)
    both = actions.extended(["long", "short"], [SubSkill(long), SubSkill(short)])
    skill = Skill("S", chain(both, *["long"] * 10, "short"), both, 11)
    stepper, asked = Stepper(skill), 0
    while not stepper.act([0.0] * 7).ended:
        asked += 1
    assert asked == 10 * 45 + 2


def test_skills_within_skills_run_out_of_actions_together() -> None:
    """Three levels of 20 transitions would be 8,000 actions; a rollout ends after 400."""
    actions = paper_actions()
    skill = Skill("looks", chain(actions, "Detect"), actions)
    for level in ("middle", "outer"):
        actions = actions.extended([skill.name], [SubSkill(skill)])
        skill = Skill(level, chain(actions, skill.name), actions)
    stepper, asked = Stepper(skill), 0
    while not (request := stepper.act([0.0] * 7)).ended:
        asked += 1
    assert (request.kind, asked) == ("timeout", most_steps(actions, 20))
    world = world_of(random_scenarios("near", 1, seeded(0)))
    runs = rollout(skill.graph, actions, world, max_transitions=20)
    assert (int(runs.transitions), bool(runs.timed_out)) == (asked, True)


class Notes(Action):
    """Notes all that it gets, and leaves a message and a memory."""

    num_parameters = 2
    message_size = memory_size = 2

    def __init__(self) -> None:
        super().__init__()
        self.met = list[dict[str, Any]]()

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        told = {name: value.tolist() for name, value in vars(lanes).items()}
        sizes = environment.num_scenarios, environment.percept_size, environment.control_size
        self.met.append({**told, "parameters": parameters.tolist(), "sizes": sizes})
        message, memory = torch.full_like(lanes.message, 7), lanes.memory + 3
        has = torch.ones_like(lanes.has_message)
        return replace(lanes, message=message, memory=memory, has_message=has), lanes.step * 0


class Adds(Action):
    """Adds 1 to its memory and to the last number of a longer message."""

    message_size = 4
    memory_size = 1

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        message = lanes.message + torch.tensor([0.0, 0.0, 0.0, 1.0])
        return replace(lanes, message=message, memory=lanes.memory + 1), lanes.step * 0


def noting() -> tuple[Skill, Notes]:
    """A skill that notes, perceives, and notes again, beside one with more words."""
    notes = Notes()
    actions = walking_actions().extended(["Adds", "Notes"], [Adds(), notes])
    graph = chain(actions, "Notes", "Adds", "Step", "Aim")
    graph.parameters[0, 0, :2] = torch.tensor([1.5, -2.0])
    return Skill("S", graph, actions), notes


FIRST = {
    "percept": [[0.25, 0.5]], "state": [[]], "message": [[0, 0, 0, 0]], "has_message": [False],
    "memory": [[0, 0]], "scenario": [0], "step": [0], "parameters": [[1.5, -2.0]],
    "sizes": (1, 2, 1),
}  # fmt: skip
LATER = {"percept": [[1, 2]], "memory": [[3, 3]], "has_message": [True], "step": [4]}


def test_an_action_of_ones_own_gets_what_a_rollout_would_give_it() -> None:
    """And again after a robot acted, with what it left behind."""
    skill, notes = noting()
    stepper = Stepper(skill)
    assert stepper.act([0.25, 0.5]) == Request("control", "Step", (7,))
    assert notes.met == [FIRST]
    assert stepper.act([1.0, 2.0]) == Request("control", "Step", (7,))
    assert notes.met[1] == {**FIRST, **LATER, "message": [[0, 7, 7, 8]]}


def test_an_exported_step_gives_it_the_same() -> None:
    """First it is tried on zeros."""
    skill, notes = noting()
    step = SkillStep(skill)
    zeros = {"percept": [[0, 0]], "parameters": [[0, 0]]}
    assert notes.met == [{**FIRST, **zeros}]
    _, outcome, place, mind = step.first()
    _, control, place, mind = step(torch.tensor([0.25, 0.5]), outcome, place, mind)
    step(torch.tensor([1.0, 2.0]), outcome, place, mind)
    assert control.tolist() == [7]
    here = [told for told in notes.met if told["parameters"] == [[1.5, -2.0]]]
    assert here[0] == FIRST
    assert {**FIRST, **LATER, "message": [[0, 7, 7, 8]]} in here


def test_a_network_sees_the_percept_of_its_turn() -> None:
    graph = chain(walking_actions(), "Aim", "Step")
    graph.parameters[0, 0, :2] = torch.tensor([1.0, 2.0])
    graph.parameters[0, 0, 9] = 4.0
    stepper = Stepper(Skill("S", graph, walking_actions()))
    sent = [stepper.act(percept).control[0] for percept in ([0.0, 0.0], [1.0, 0.0], [0.0, 1.0])]
    sums = torch.tensor([0.0, 1.0, 2.0])
    assert sent == pytest.approx((4 * sums.sigmoid()).tolist())


def test_what_was_asked_for_succeeds_unless_one_says_that_it_did_not() -> None:
    actions = walking_actions()
    stepper = Stepper(Skill("S", chain(actions, "Test"), actions))
    assert stepper.act([0.0, 0.0]) == Request("test", "Test")
    unclear: Any = "no"
    with pytest.raises(SettingsError, match="done is 'no'; give True or False"):
        stepper.act([0.0, 0.0], done=unclear)
    assert stepper.act([0.0, 0.0], done=False) == Request("test", "Test")
    assert stepper.act([0.0, 0.0]) == Request("success")


class Drives(Step):
    """A step whose outcomes have other names."""

    outcomes = ("moved", "stuck")
    request = "control"


class Looks(Perceive):
    """A look that tells what came of it."""

    outcomes = ("seen",)
    request = "perceive"


def test_routines_of_ones_own_have_outcomes_of_their_own() -> None:
    aim, base = walking_actions().actions[0], ("Aim", "Drives", "Looks", "Counter")
    actions = ActionSet(base, (aim, Drives(1), Looks(), Counter()))
    edges = {(1, "moved"): 0, (1, "stuck"): 2}
    skill = Skill("S", chain(actions, "Aim", "Drives", "Looks", edges=edges), actions)
    stepper = Stepper(skill)
    assert stepper.act([0.0, 0.0]) == Request("control", "Drives", (0.0,))
    assert stepper.act([0.0, 0.0], done=True) == Request("control", "Drives", (0.0,))
    assert stepper.act([0.0, 0.0], done=False) == Request("perceive", "Looks")
    assert stepper.act([0.0, 0.0]).kind == "control"


def test_a_step_s_controls_are_as_long_as_the_longest() -> None:
    actions = ActionSet(("one", "three", "Counter"), (Step(1), Step(3), Counter()))
    skill = Skill("S", chain(actions, "one", "three", "Counter"), actions)
    assert SkillStep(skill, 7).control_size == 3
    alone = ActionSet(("Counter",), (Counter(),))
    assert SkillStep(Skill("S", chain(alone, "Counter"), alone), 7).control_size == 4


@pytest.mark.parametrize("thing", [None, "s.json", 3, noting()[0].graph], ids=str)
@pytest.mark.parametrize("use", [*FORMATS.values(), SkillStep, draw_skill])
def test_what_is_no_skill_is_neither_exported_nor_drawn(use: Any, thing: Any) -> None:
    with pytest.raises(SettingsError, match=r"skill is .*; give a Skill, such as load_skill"):
        use(thing)


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ((None,), "skill is None; give a Skill, such as load_skill returns"),
        (("a/skill.json",), "skill is 'a/skill.json'; give a Skill"),
        ((noting()[0], 1.5), "seed is 1.5; give a whole number"),
        ((noting()[0], 0, "x"), "max_steps is 'x'; give a whole number"),
    ],
)
def test_what_cannot_be_stepped_is_said(about: tuple[Any, ...], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Stepper(*about)
