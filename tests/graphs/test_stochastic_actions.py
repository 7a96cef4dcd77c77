"""Actions that draw random numbers: what they draw belongs to the scenario and to nothing else."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    FOOTPRINT,
    Counter,
    Wander,
    graspable,
    model,
    random_graphs,
    stochastic_actions,
    world,
)
from torch import Tensor

from cgtorch.graphs import Action, ActionSet, Graphs, Skill, SubSkill, check_action
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import ActionError, ModelError
from cgtorch.simulation import ModelEnvironment, Recording, rollout
from cgtorch.tabletop.actions import Detect, paper_actions
from cgtorch.tabletop.world import Noise, TabletopWorld

ACTIONS = stochastic_actions()
STILL = Noise(0.0, 0.0)


def wandering(seed: int, count: int) -> Graphs:
    """Random graphs that begin with Wander."""
    many = random_graphs(seed, 40 * count, ACTIONS)
    wander = ACTIONS.index("Wander")
    first = many.action.gather(1, many.start[:, None])[:, 0]
    found = (first == wander).nonzero()[:, 0][:count]
    assert len(found) == count
    return many[found]


@settings(max_examples=15)
@given(seed=st.integers(0, 2**31 - 1), scenario=st.integers(0, 7), individual=st.integers(0, 2))
def test_a_lane_alone_draws_what_it_draws_among_others(
    seed: int, scenario: int, individual: int
) -> None:
    graphs, whole = wandering(seed, 3), world(seed, 8)
    among = rollout(graphs, ACTIONS, whole)
    one = slice(individual, individual + 1)
    moved = TabletopWorld(whole.scenarios[torch.tensor([scenario])], graspable, FOOTPRINT)
    for alone in (
        rollout(graphs[one], ACTIONS, whole, scenarios=torch.tensor([scenario])),
        rollout(graphs[one], ACTIONS, moved),  # there it is scenario 0
        rollout(graphs[one], ACTIONS, Recording(moved)),
    ):
        for name in ("succeeded", "timed_out", "percept", "state", "transitions"):
            found, expected = getattr(alone, name), getattr(among, name)
            assert torch.equal(found[0, 0], expected[individual, scenario]), name


def test_seeds_of_scenarios_decide() -> None:
    graphs, first = wandering(1, 4), world(0, 6, STILL)
    other = TabletopWorld(first.scenarios.with_noise(1), graspable, FOOTPRINT, STILL)
    runs, again = rollout(graphs, ACTIONS, first), rollout(graphs, ACTIONS, other)
    assert not torch.equal(runs.percept, again.percept)
    models = model(0, 6)
    parts = models.percepts, models.gamma, models.classifier, models.possible
    one, two, three = (
        rollout(graphs, ACTIONS, ModelEnvironment(*parts, seeds=seeds)).percept
        for seeds in (None, torch.arange(6), torch.arange(6) + 6)
    )
    assert torch.equal(one, two)
    assert not torch.equal(one, three)


@pytest.mark.parametrize("seeds", [torch.arange(5), torch.arange(6.0)])
def test_seeds_of_another_shape_are_refused(seeds: Tensor) -> None:
    models = model(0, 6)
    parts = models.percepts, models.gamma, models.classifier, models.possible
    with pytest.raises(ModelError, match=r"seeds are a tensor .* give"):
        ModelEnvironment(*parts, seeds=seeds)


def test_a_skill_draws_the_same_within_another_one() -> None:
    """What was solved stays solved where an earlier skill is a node of a later one."""
    environment, first = world(3, 40), paper_actions()
    found = 0
    for seed in range(12):
        inner = Skill("inner", wandering(seed, 1), ACTIONS)
        actions = first.extended(["inner"], [SubSkill(inner)])
        # A network that leads to the skill whatever it answers, so the skill begins a step later.
        edges = torch.full((1, 2, actions.outcome_capacity), -1)
        edges[0, 0, :2], edges[0, 1, 1] = 1, 0
        action = torch.tensor([[actions.index("BranchingNN"), actions.index("inner")]])
        parameters = torch.zeros(1, 2, actions.parameter_capacity)
        outer = Skill("outer", Graphs(action, edges, parameters, torch.tensor([0])), actions)
        alone = rollout(inner.graph, inner.actions, environment)
        within = rollout(outer.graph, outer.actions, environment, max_transitions=2)
        solved = alone.succeeded
        assert within.succeeded[solved].all()
        assert torch.equal(within.percept[solved], alone.percept[solved])
        assert torch.equal(within.transitions[solved], alone.transitions[solved] + 1)
        found += int(solved.sum())
    assert found > 20


def test_every_outcome_is_taken() -> None:
    graphs, seen = wandering(0, 20), list[Tensor]()
    wander = ACTIONS.index("Wander")

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        seen.append(outcome[graphs.action.flatten()[node] == wander])

    rollout(graphs, ACTIONS, world(0, 5), trace=trace)
    assert torch.cat(seen).unique().tolist() == list(range(len(Wander.outcomes)))


class Unmarked(Wander):
    deterministic = True


class Forgetful(Wander):
    memory_size = 0


@pytest.mark.parametrize("action", [Unmarked(), Forgetful()])
def test_what_draws_says_so(action: Action) -> None:
    with pytest.raises(ActionError, match="give it deterministic = False and a memory_size of at"):
        check_action("mine", action, model(0, 2))


class GlobalDraw(Detect):
    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, outcome = super().forward(lanes, parameters, environment)
        return replace(lanes, percept=lanes.percept + torch.rand(len(lanes), 1)), outcome


class Mean(Detect):
    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, outcome = super().forward(lanes, parameters, environment)
        first = lanes.percept[:1].expand_as(lanes.percept)
        return replace(lanes, percept=lanes.percept - first), outcome


@pytest.mark.parametrize("action", [GlobalDraw(), Mean()])
def test_what_looks_at_other_lanes_or_draws_otherwise_is_refused(action: Action) -> None:
    with pytest.raises(ActionError, match="the same two lanes in another order; treat each lane"):
        check_action("mine", action, model(0, 2))


def test_numbers_go_on_from_draw_to_draw() -> None:
    action, environment = Wander(), world(0, 50)
    lanes = start_lanes(environment, torch.arange(50), 3, 2)
    seen = []
    for _ in range(3):
        lanes, drawn = action.uniform(lanes, environment, 3)
        seen.append(drawn)
    lanes, drawn = action.normal(lanes, environment, 3)
    assert drawn.shape == (50, 3)
    assert torch.equal(lanes.memory, torch.tensor([[0.0, 4.0]]).expand(50, 2))
    assert len(torch.cat(seen).unique()) > 445


class Here(Counter):
    """Another one's Counter."""


class There(Counter):
    memory_part: str = "counted"


class Everywhere(There):
    memory_size = 3


def memory_after(first: Action, second: Action) -> list[float]:
    """What the common memory holds after one visit of one action and two of another."""
    actions = ActionSet(("one", "two", "then"), (first, second, Detect()))
    edges = torch.full((1, 4, actions.outcome_capacity), -1)
    edges[0, 0, :2], edges[0, 1, :2], edges[0, 2, :2] = 1, 2, 3
    edges[0, 3, 0] = 3
    graph = Graphs(torch.tensor([[0, 1, 1, 2]]), edges, torch.zeros(1, 4, 2), torch.tensor([0]))
    last: list[Tensor] = []
    environment = model(0, 1)
    environment.percepts[:, 4] = -1.0  # so that none is lost
    rollout(
        graph, actions, environment, max_transitions=3,
        trace=lambda active, node, outcome, lanes: last.append(lanes.memory.clone()),
    )  # fmt: skip
    return last[-1][0].tolist()


def test_actions_do_not_touch_each_others_memory() -> None:
    assert memory_after(Counter(), Here()) == [1, -1, 2, -1]


def test_actions_that_name_the_same_part_share_it() -> None:
    assert memory_after(There(), There()) == [3, -1]
    assert memory_after(Everywhere(), There()) == [3, -1, 0]
    assert memory_after(There(), Counter()) == [1, -1, 2, -1]
