"""The batched engine against a plain interpreter of Algorithm 3, and what batches must not do."""

from collections import Counter as Count
from collections.abc import Callable
from typing import Any

import pytest
import reference
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    as_double,
    as_double_actions,
    custom_actions,
    judged_by,
    model,
    nested_actions,
    random_graphs,
    random_skill,
    recurrent_actions,
    seeded,
    stochastic_actions,
    world,
)
from told_by_runs import tensors_of
from torch import Tensor
from walking import chain

from cgtorch.graphs import ActionSet, Graphs, Skill, SubSkill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import SettingsError, WorldError
from cgtorch.simulation import Rollouts, rollout
from cgtorch.simulation.program import compile_graphs
from cgtorch.tabletop.actions import Detect, paper_actions

PLAIN_SETS = [
    paper_actions(),
    stochastic_actions(),
    nested_actions(0),
    nested_actions(40, base=stochastic_actions()),
    recurrent_actions(),
    nested_actions(0, recurrent_actions()),
]
SETS = [as_double_actions(s) for s in PLAIN_SETS]  # so that rounding cannot turn a branch
ENVIRONMENTS: dict[str, Callable[..., Environment]] = {"world": world, "model": model}


def ends(result: Rollouts) -> list[list[str]]:
    pairs = zip(result.succeeded.tolist(), result.timed_out.tolist(), strict=True)
    return [
        ["success" if s else "timeout" if t else "failure" for s, t in zip(*rows, strict=True)]
        for rows in pairs
    ]


def compare(
    graphs: Graphs, actions: ActionSet, environment: Environment, limit: int, steps: int
) -> Count[str]:
    """Assert that engine and interpreter agree on everything; count the ends."""
    result = rollout(graphs, actions, environment, max_transitions=limit, max_steps=steps)
    found: Count[str] = Count()
    for i in range(len(graphs)):
        for j in range(environment.num_scenarios):
            one = graphs[i : i + 1]
            end, count, percept = reference.run(one, actions, environment, j, limit, steps)
            assert ends(result)[i][j] == end
            assert int(result.transitions[i, j]) == count
            assert result.percept[i, j].tolist() == pytest.approx(percept, abs=1e-9)
            found[end] += 1
    return found


@pytest.mark.parametrize("place", ENVIRONMENTS)
@given(
    seed=st.integers(0, 2**31),
    actions=st.sampled_from(SETS),
    limit=st.integers(1, 20),
    steps=st.integers(1, 40),
)
@settings(max_examples=15)
def test_engine_equals_the_interpreter(
    place: str, seed: int, actions: ActionSet, limit: int, steps: int
) -> None:
    graphs = as_double(random_graphs(seed, 6, actions))
    environment = ENVIRONMENTS[place](seed, 4, dtype=torch.float64)
    compare(graphs, actions, environment, limit, steps)


@pytest.mark.parametrize("place", ENVIRONMENTS)
def test_the_comparison_meets_every_end(place: str) -> None:
    environment = ENVIRONMENTS[place](1, 4, dtype=torch.float64)
    found: Count[str] = Count()
    for actions in (SETS[0], SETS[2]):
        graphs = as_double(random_graphs(1, 40, actions))
        found += compare(graphs, actions, environment, 20, 60)
    assert all(found[end] >= 10 for end in ("success", "failure", "timeout")), found


@given(
    seed=st.integers(0, 2**31),
    actions=st.sampled_from(PLAIN_SETS),
    place=st.sampled_from(list(ENVIRONMENTS)),
)
@settings(max_examples=15)
def test_a_result_does_not_depend_on_the_rest_of_the_batch(
    seed: int, actions: ActionSet, place: str
) -> None:
    graphs, environment = random_graphs(seed, 12, actions), ENVIRONMENTS[place](seed, 8)
    everything = rollout(graphs, actions, environment)
    some = torch.randperm(12, generator=seeded(seed))[:5]
    where = torch.randperm(8, generator=seeded(seed))[:3]
    part = rollout(graphs[some], actions, environment, scenarios=where)
    for name, value in tensors_of(part).items():
        assert torch.equal(value, getattr(everything, name)[some][:, where]), name


@pytest.mark.parametrize(("p", "b"), [(0, 3), (2, 0), (0, 0)])
def test_an_empty_batch_gives_an_empty_result(p: int, b: int) -> None:
    actions = paper_actions()
    result = rollout(
        random_graphs(0, 4, actions)[:p],
        actions,
        world(0, 3),
        scenarios=torch.arange(b),
    )
    assert result.succeeded.shape == result.timed_out.shape == result.transitions.shape == (p, b)
    assert result.percept.shape == (p, b, 7)


def test_a_loop_times_out_after_exactly_the_limit() -> None:
    actions = paper_actions()
    for limit in (1, 7, 20):
        result = rollout(chain(actions, "Detect"), actions, world(0, 2), max_transitions=limit)
        assert result.timed_out.all()
        assert not result.succeeded.any()
        assert (result.transitions == limit).all()


def test_a_terminal_outcome_on_the_last_transition_still_counts() -> None:
    actions, environment = paper_actions(), model(0, 1)
    environment = judged_by(environment, lambda p: torch.ones(len(p)))
    graph = chain(actions, "Detect", "Detect", "Grasp")
    assert rollout(graph, actions, environment, max_transitions=3).succeeded.all()
    assert rollout(graph, actions, environment, max_steps=3).succeeded.all()
    assert rollout(graph, actions, environment, max_transitions=2).timed_out.all()
    assert rollout(graph, actions, environment, max_steps=2).timed_out.all()


def test_grasp_needs_more_than_one_half() -> None:
    actions, environment = paper_actions(), model(0, 3)
    environment = judged_by(environment, lambda p: torch.tensor([0.49, 0.5, 0.51])[: len(p)])
    result = rollout(chain(actions, "Grasp"), actions, environment, max_transitions=1)
    assert result.succeeded.tolist() == [[False, False, True]]


def test_a_sub_skill_keeps_its_own_limit_and_counts_as_one_transition() -> None:
    base, environment = paper_actions(), model(0, 1)
    loop = Skill("loop", chain(base, "Detect"), base, max_transitions=4)
    actions = base.extended(["loop"], [SubSkill(loop)])
    # Twice through the loop, which fails each time, then a grasp that fails for ever.
    graph = chain(actions, "loop", "loop", "Grasp", edges={(2, "failure"): 2})
    environment = judged_by(environment, lambda p: torch.zeros(len(p)))
    result = rollout(graph, actions, environment, max_transitions=6)
    assert result.timed_out.all()
    assert result.transitions.item() == 4 + 4 + 4  # two loops, then 6 - 2 grasps


def test_success_of_a_nested_skill_ends_every_level_and_failure_follows_the_edge() -> None:
    base, environment = custom_actions(), model(0, 1)
    inner = Skill("inner", chain(base, "Grasp"), base, max_transitions=2)
    one = base.extended(["inner"], [SubSkill(inner)])
    middle = Skill("middle", chain(one, "inner", "Detect"), one, max_transitions=3)
    two = one.extended(["middle"], [SubSkill(middle)])
    graph = chain(two, "middle", "Detect", edges={(1, "success"): 1})
    environment = judged_by(environment, lambda p: torch.ones(len(p)))
    result = rollout(graph, two, environment)
    assert result.succeeded.all()
    assert result.transitions.item() == 1
    environment = judged_by(environment, lambda p: torch.zeros(len(p)))
    result = rollout(graph, two, environment, max_transitions=3)
    # inner: 2 grasps; middle: inner, Detect, inner; top: middle, then two more Detects.
    assert result.transitions.item() == 2 + 1 + 2 + 2
    assert result.timed_out.all()


def test_message_and_memory_pass_into_and_out_of_sub_skills() -> None:
    base, environment = custom_actions(), model(0, 1)
    count = Skill("count", chain(base, "Counter", "Detect"), base, max_transitions=1)
    actions = base.extended(["count"], [SubSkill(count)])
    seen: list[tuple[list[float], bool]] = []

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        seen.append((lanes.memory[0].tolist(), bool(lanes.has_message[0])))

    environment.percepts = torch.zeros(1, 7)
    graph = chain(actions, "Counter", "ContinuousNN", "count", "Detect")
    rollout(graph, actions, environment, max_transitions=4, trace=trace)
    assert [memory[0] for memory, _ in seen] == [1, 1, 2, 2]
    assert [has for _, has in seen] == [False, True, True, True]


def test_move_base_without_a_message_fails_even_where_everything_is_possible() -> None:
    actions, environment = paper_actions(), model(0, 3)
    environment.possible = lambda p, u: torch.ones(len(p), dtype=torch.bool)
    result = rollout(chain(actions, "MoveBase"), actions, environment, max_transitions=2)
    assert torch.equal(result.percept[0], environment.percepts)


def test_the_trace_tells_lanes_nodes_and_outcomes() -> None:
    actions, environment = paper_actions(), model(0, 2)
    percepts = environment.percepts
    environment = judged_by(environment, lambda p: (p == percepts[1]).all(1).float())
    told: list[tuple[list[int], list[int], list[int]]] = []

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        assert len(lanes) == len(active)
        told.append((active.tolist(), node.tolist(), outcome.tolist()))

    graph = chain(actions, "Detect", "Grasp")
    rollout(graph, actions, environment, max_transitions=3, trace=trace)
    assert told == [([0, 1], [0, 0], [0, 0]), ([0, 1], [1, 1], [1, 0]), ([0], [0], [0])]


def test_lanes_of_an_action_come_in_the_order_of_their_numbers() -> None:
    """Whatever they did before, so that what is recorded of them has an order of its own."""
    actions, environment = paper_actions(), model(0, 9)
    graphs = random_graphs(5, 30, actions)
    kinds, steps = compile_graphs(graphs, actions).kind, list[Tensor]()

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        steps.append(kinds[node] * 30 * 9 + active)

    rollout(graphs, actions, environment, trace=trace)
    assert len(steps) == 20
    assert all((order.diff() > 0).all() for order in steps)


def test_a_skill_stored_once_may_be_used_at_several_levels() -> None:
    actions = nested_actions(7)
    top = random_skill(9, "top", actions)
    assert set(top.sub_skills) == {"S0", "S1"}
    assert top.depth == 3
    again = as_double_actions(actions)
    compare(as_double(top.graph), again, world(2, 4, dtype=torch.float64), 20, 60)


class Calls(Detect):
    """Does nothing, and counts how often it is asked to."""

    def __init__(self, deterministic: bool):
        super().__init__()
        self.deterministic, self.calls = deterministic, 0

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        self.calls += 1
        return lanes, torch.zeros(len(lanes), dtype=torch.long)


@pytest.mark.parametrize("length", [1, 2, 3, 5])
def test_endless_loops_are_counted_but_not_executed(length: int) -> None:
    for deterministic in (True, False):
        action = Calls(deterministic)
        actions = paper_actions().extended(["Calls"], [action])
        graph = chain(actions, *["Calls"] * length)
        result = rollout(graph, actions, model(0, 1), max_transitions=40)
        assert result.timed_out.all()
        assert result.transitions.item() == 40
        assert (action.calls < 20) if deterministic else (action.calls == 40)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"graphs": None}, "graphs is None; give Graphs, such as skill.graph"),
        ({"graphs": random_skill(0, "S", paper_actions())}, r"graphs is Skill\(.*; give Graphs"),
        ({"actions": None}, r"actions is None; give an ActionSet, such as domain.actions\(\)"),
        ({"environment": None}, "environment is None; give an Environment, such as"),
        ({"environment": type(world(0, 3))}, "environment is <class .*; give an Environment"),
        ({"max_transitions": "5"}, "max_transitions is '5'; give a whole number from 0 to"),
        ({"max_steps": 1.5}, "max_steps is 1.5; give a whole number from 0 to"),
    ],
)
def test_what_cannot_be_rolled_out_is_said(wrong: dict[str, Any], message: str) -> None:
    skill = random_skill(0, "S", paper_actions())
    about: dict[str, Any] = {"graphs": skill.graph, "actions": skill.actions}
    about |= {"environment": world(0, 3), **wrong}
    with pytest.raises((SettingsError, WorldError), match=message):
        rollout(**about)
