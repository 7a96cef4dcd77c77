"""A skill step by step equals the engine: requests, motions, ends, counts."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
import torch
from driving import act, assert_same, by_steps, by_the_library, reference
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    Counter,
    Visits,
    Wander,
    custom_actions,
    model,
    nested_actions,
    random_skill,
    seeded,
    world,
)
from torch import Tensor, nn

from cgtorch.export import SkillStep
from cgtorch.export.step import REQUESTS
from cgtorch.graphs import Action, ActionSet, Graphs, Skill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, SettingsError
from cgtorch.tabletop.actions import Grasp, MoveBase, paper_actions

seeds = st.integers(0, 2**31 - 1)


@settings(max_examples=5)
@given(seeds, st.sampled_from([400, 7, 1]), st.integers(1, 20))
def test_skills_in_skills_with_memory_and_messages(seed: int, steps: int, most: int) -> None:
    skill = random_skill(seed, "S2", nested_actions(seed), max_transitions=most)
    environment = model(seed, 3)
    expected, _ = by_the_library(skill, environment, steps)
    step = SkillStep(skill, 7, steps)
    for scenario, run in enumerate(expected):
        assert_same(by_steps(step, step.about(), environment, scenario), run)


@settings(max_examples=4)
@given(seeds)
def test_two_actions_with_memory_of_their_own(seed: int) -> None:
    base = nested_actions(seed, custom_actions().extended(["Visits"], [Visits()]))
    skill = random_skill(seed, "S2", base)
    environment = model(seed, 3)
    expected, _ = by_the_library(skill, environment)
    step = SkillStep(skill, percept_size=7)
    assert step.memory_size == 4
    for scenario, run in enumerate(expected):
        assert_same(by_steps(step, step.about(), environment, scenario), run)


def test_random_numbers_cannot_be_carried_along() -> None:
    with pytest.raises(ActionError, match="'Mine' cannot be exported: it is not deterministic"):
        SkillStep(lone(Wander()), percept_size=7)


def test_the_reference_skill_in_a_world_with_noise() -> None:
    _, skill = reference()
    place = world(3, 4)
    expected, _ = by_the_library(skill, place)
    assert {run.end for run in expected} >= {"success"}
    step = SkillStep(skill)
    for scenario, run in enumerate(expected):
        assert_same(by_steps(step, step.about(), place, scenario), run)


def test_all_ends_are_met_in_these_tests() -> None:
    ends = set()
    for seed in range(6):
        skill = random_skill(seed, "S2", nested_actions(seed))
        ends |= {run.end for run in by_the_library(skill, model(seed, 4))[0]}
    assert ends == {"success", "failure", "timeout"}


def test_after_its_end_a_skill_stays_as_it_is() -> None:
    skill = random_skill(1, "S", custom_actions())
    step = SkillStep(skill)
    percept, outcome, place, mind = step.first()
    for _ in range(500):
        request, _, place, mind = step(percept, outcome, place, mind)
        if int(request) < 3:
            break
    for out in (0, 1):
        again = step(percept + 1, torch.tensor(out), place, mind)
        assert int(again[0]) == int(request)
        assert torch.equal(again[1], torch.zeros(3))
        assert torch.equal(again[2], place)
        assert torch.equal(again[3], mind)


def lone(action: Action, name: str = "Mine", then: type[Action] = Grasp) -> Skill:
    """A skill that does one action, then another one, and begins again where that fails."""
    actions = ActionSet((name, "then"), (action, then()))
    edges = torch.full((1, 2, actions.outcome_capacity), -1)
    for i, outcome in enumerate(action.outcomes):
        edges[0, 0, i] = -1 if outcome in action.terminal else 1
    edges[0, 1, 1] = 0
    if then is MoveBase:
        edges[0, 1, 0] = 0
    parameters = torch.randn(1, 2, actions.parameter_capacity, generator=seeded(0))
    parameters[0, :, action.num_parameters :] = 0
    graph = Graphs(torch.tensor([[0, 1]]), edges, parameters, torch.tensor([0]))
    return Skill("lone", graph, actions)


class Learned(Action):
    """A network of its own weights and a constant; sends a motion."""

    num_parameters = 2
    message_size = 3

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Linear(7, 3)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        motion = self.net(lanes.percept) * torch.tensor([0.1, 0.2, 0.3]) + parameters[:, :1]
        has = torch.ones_like(lanes.has_message)
        lanes = replace(lanes, message=motion, has_message=has)
        return lanes, torch.zeros(len(lanes), dtype=torch.long)


class AsksTheWorld(Action):
    message_size = 3

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, moved = environment.step(lanes, lanes.message / 2)
        return lanes, (~moved).long() * 0


class Random(Learned):
    deterministic = False


class Sees(Learned):
    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, out = super().forward(lanes, parameters, environment)
        return replace(lanes, percept=lanes.percept + 1), out


class SlowBase(MoveBase):
    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        return super().forward(replace(lanes, message=lanes.message / 2), parameters, environment)


class Precise(Learned):
    """Sends numbers of another type than percepts have."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, outcome = super().forward(lanes, parameters, environment)
        return replace(lanes, message=lanes.message.double()), outcome


@pytest.mark.parametrize(
    ("action", "why"),
    [
        (AsksTheWorld(), "asks its environment for 'step'"),
        (SlowBase(), "asks its environment for 'step'"),
        (Random(), "not deterministic"),
        (Sees(), "writes lanes.percept"),
        (Precise(), "message is torch.float64; make it torch.float32"),
    ],
)
def test_an_action_that_needs_more_than_it_is_given_is_named(action: Action, why: str) -> None:
    with pytest.raises(ActionError, match=f"action 'Mine' cannot be exported: it.*{why}.*state-"):
        SkillStep(lone(action), percept_size=7)


def test_an_action_that_fails_is_named() -> None:
    with pytest.raises(ActionError, match="action 'Mine' cannot be exported: RuntimeError"):
        SkillStep(lone(Learned()), percept_size=8)


def test_actions_that_no_node_uses_do_no_harm() -> None:
    both = paper_actions().extended(["Asks"], [AsksTheWorld()])
    graph = Graphs(
        torch.tensor([[2]]), torch.tensor([[[-1, 0]]]), torch.zeros(1, 1, 33), torch.tensor([0])
    )
    step = SkillStep(Skill("grasp", graph, both), percept_size=7)
    assert REQUESTS[int(step(*step.first())[0])] == "test"


def test_the_percept_has_to_be_known() -> None:
    with pytest.raises(SettingsError, match="'lone' has no network that tells the length"):
        SkillStep(lone(Counter()))
    assert SkillStep(lone(Counter()), percept_size=7).percept_size == 7


def test_a_robot_is_never_sent_where_no_number_is() -> None:
    """A message that is not finite, or none at all, makes MoveBase fail without asking."""
    step = SkillStep(lone(Learned(), then=MoveBase), percept_size=7)
    percept, outcome, place, mind = step.first()
    request, control, *_ = step(percept, outcome, place, mind)
    assert REQUESTS[int(request)] == "control"
    assert control.isfinite().all()
    request, control, place, _ = step(percept * torch.nan, outcome, place, mind)
    assert REQUESTS[int(request)] == "timeout"
    assert int(place[3]) == 20
    assert torch.equal(control, torch.zeros(3))


class Ends(Counter):
    terminal: Mapping[str, bool] = {"again": True, "enough": True, "lost": False}


def test_an_end_without_any_routine() -> None:
    actions = ActionSet(("Ends",), (Ends(),))
    graph = Graphs(
        torch.tensor([[0]]), torch.full((1, 1, 3), -1), torch.zeros(1, 1, 2), torch.tensor([0])
    )
    skill = Skill("ends", graph, actions)
    environment = world(0, 30)
    expected, _ = by_the_library(skill, environment)
    assert {run.end for run in expected} == {"success", "failure"}
    step = SkillStep(skill, percept_size=7)
    for scenario, run in enumerate(expected):
        assert_same(by_steps(step, step.about(), environment, scenario), run)
    with pytest.raises(AssertionError):
        act("Wait", *[None] * 3)  # type: ignore[arg-type]
