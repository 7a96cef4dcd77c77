"""Rollouts that wait for Python, against the engine in torch."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import models_as, random_models
from support import (
    as_double,
    as_double_actions,
    custom_actions,
    nested_actions,
    random_graphs,
    recurrent_actions,
    stochastic_actions,
    world,
)
from told_by_runs import tensors_of
from torch import Tensor
from walking import Path, Walks, chain, path, walking_actions

from cgtorch import native
from cgtorch.graphs import Action, ActionSet, Graphs
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError
from cgtorch.native import available
from cgtorch.simulation import Rollouts, rollout
from cgtorch.simulation.program import compile_graphs
from cgtorch.simulation.resumable import resumable_rollout
from cgtorch.simulation.rollout import MAX_STEPS, engine_of
from cgtorch.simulation.torch_engine import MOST_IDLE, rollout_in_torch
from cgtorch.tabletop.actions import paper_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SETS = [
    as_double_actions(actions)
    for actions in (
        custom_actions(),
        stochastic_actions(),
        nested_actions(0, custom_actions()),
        nested_actions(40, stochastic_actions()),
        recurrent_actions(),
        nested_actions(0, recurrent_actions()),
    )
]


def waiting(
    graphs: Graphs, actions: ActionSet, environment: Environment, limits: tuple[int, int]
) -> Rollouts:
    some = torch.arange(environment.num_scenarios)
    engine = engine_of(actions, environment)
    found = resumable_rollout(graphs, actions, environment, some, (*limits, MOST_IDLE), engine)
    assert found is not None
    return found


def in_torch(
    graphs: Graphs, actions: ActionSet, environment: Environment, limits: tuple[int, int]
) -> Rollouts:
    some = torch.arange(environment.num_scenarios)
    return rollout_in_torch(compile_graphs(graphs, actions), environment, some, *limits)


def assert_same(found: Rollouts, wanted: Rollouts, within: float) -> None:
    for name, value in tensors_of(wanted).items():
        mine = getattr(found, name)
        if value.is_floating_point():
            torch.testing.assert_close(mine, value, atol=within, rtol=0, equal_nan=True)
        else:
            assert torch.equal(mine, value), name


@given(
    seed=st.integers(0, 2**31),
    actions=st.sampled_from(SETS),
    in_world=st.booleans(),
    limits=st.tuples(st.integers(1, 20), st.integers(1, 60)),
)
@settings(max_examples=15)
def test_own_actions_do_what_they_do_in_torch(
    seed: int, actions: ActionSet, in_world: bool, limits: tuple[int, int]
) -> None:
    graphs = as_double(random_graphs(seed, 20, actions))
    place: Environment = random_models(seed, 5)
    if in_world:
        place = world(seed, 5, dtype=torch.float64)
    given = graphs, actions, place, limits
    assert_same(waiting(*given), in_torch(*given), 1e-8)


@given(seed=st.integers(0, 2**31), scene=st.sampled_from([("box", 0), ("box", 1), ("yaw", 3)]))
@settings(max_examples=10)
def test_where_nothing_needs_python_both_ways_give_the_same_bits(
    seed: int, scene: tuple[str, int]
) -> None:
    environment = models_as(random_models(seed, 21, *scene), torch.float32)
    actions = paper_actions(environment.percept_size)
    graphs, some = random_graphs(seed, 30, actions), torch.arange(21)
    engine = engine_of(actions, environment)
    assert engine is not None
    wanted = engine.rollouts(graphs, some, 20, MAX_STEPS)
    found = waiting(graphs, actions, environment, (20, MAX_STEPS))
    assert wanted is not None
    assert found.executed == wanted.executed
    for name, value in tensors_of(wanted).items():
        assert torch.equal(getattr(found, name), value), name


@pytest.mark.parametrize("actions", [SETS[3], SETS[5]])
def test_no_number_of_threads_changes_anything(actions: ActionSet) -> None:
    environment = world(0, 40, dtype=torch.float64)
    graphs = as_double(random_graphs(2, 60, actions))  # more lanes than one thread takes at once
    found = []
    for count in (1, 2, 5):
        native.use_threads(count)
        found.append(waiting(graphs, actions, environment, (20, 60)))
    for other in found[1:]:
        for name, value in tensors_of(found[0]).items():
            assert torch.equal(getattr(other, name), value), name


class Says(Action):
    """Returns an outcome that it does not have."""

    def __init__(self, outcome: int) -> None:
        super().__init__()
        self.outcome = outcome

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        return lanes, torch.full((len(lanes),), self.outcome)


@pytest.mark.parametrize("outcome", [7, -1])
def test_an_outcome_that_there_is_not_is_named(outcome: int) -> None:
    actions = paper_actions().extended(["Says"], [Says(outcome)])
    graphs = random_graphs(0, 30, actions)
    with pytest.raises(ActionError, match=rf"Says returned outcome {outcome}; return 0 to 0"):
        rollout(graphs, actions, world(0, 4))


class Reused(Path):
    """A world that returns the same memory each time, and states of another type."""

    def first_state(self, scenario: Tensor) -> Tensor:
        self.room = super().first_state(scenario).double()
        return self.room

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        after = super().next_state(state, control.double(), scenario)
        self.room[: len(after)] = after
        return self.room[: len(after)]


def test_what_a_world_returns_is_copied_whatever_its_type() -> None:
    actions, walks = walking_actions(), Walks(torch.tensor([0.5, -1.0]), torch.ones(2))
    graphs = chain(actions, "Aim", "Step", speed=0.25)
    plain, reused = (
        rollout(graphs, actions, kind(walks), max_transitions=6) for kind in (Path, Reused)
    )
    assert reused.state.dtype == torch.float64
    assert torch.equal(reused.state.float(), plain.state)
    assert torch.equal(reused.percept, plain.percept)
    assert plain.percept[0, :, 0].tolist() == [1.25, -0.25]


def test_endless_loops_are_counted_and_rewarded_lanes_end_as_in_torch() -> None:
    actions, place = walking_actions(), path(3, 30)
    for seed in range(5):
        graphs = random_graphs(seed, 30, actions)
        found, wanted = (way(graphs, actions, place, (30, 400)) for way in (waiting, in_torch))
        assert torch.equal(found.transitions, wanted.transitions)
        assert found.executed <= int(found.transitions.sum())
        assert found.returns is not None
        assert wanted.returns is not None
        torch.testing.assert_close(found.returns, wanted.returns, atol=1e-4, rtol=0)


def test_numbers_of_another_type_than_the_percepts_run_in_torch() -> None:
    actions, place = SETS[0], world(0, 3, dtype=torch.float64)
    graphs = as_double(random_graphs(0, 4, actions))
    single = replace(graphs, parameters=graphs.parameters.float())
    some, limits = torch.arange(3), (20, MAX_STEPS, MOST_IDLE)
    assert resumable_rollout(graphs, actions, place, some, limits, None) is not None
    assert resumable_rollout(single, actions, place, some, limits, None) is None
    assert resumable_rollout(graphs, actions, place, some.int(), limits, None) is None
    assert resumable_rollout(graphs[:0], actions, place, some, limits, None) is None


@pytest.mark.parametrize(("offset", "succeeds"), [(0.0, False), (-1e-6, True)])
def test_a_chance_of_just_a_half_is_a_failure(offset: float, succeeds: bool) -> None:
    """Whether models are compiled or Python has them, in vectors of one graph or of several."""
    before, actions = random_models(0, 5, errors=False), paper_actions()
    machine = before.classifier.machine  # type: ignore[attr-defined]
    machine.weights, machine.bias = 0 * machine.weights, 0 * machine.bias
    machine.platt = torch.tensor([-1.5, offset], dtype=torch.float64)
    models = models_as(before)
    graphs, some = as_double(chain(actions, "Grasp", "Detect")), torch.arange(5)
    compiled, limits = engine_of(actions, models), (4, 9)
    assert compiled is not None
    in_python = resumable_rollout(graphs, actions, models, some, (*limits, MOST_IDLE), None)
    found = compiled.rollouts(graphs, some, *limits), waiting(graphs, actions, models, limits)
    for each in (*found, in_python, in_torch(graphs, actions, models, limits)):
        assert each is not None
        assert bool((each.succeeded == succeeds).all())
        assert bool((each.timed_out != succeeds).all())


class Precise(Path):
    """A world with states in double precision below percepts in single, and a wall at 1."""

    def first_state(self, scenario: Tensor) -> Tensor:
        return super().first_state(scenario).double()

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        after = super().next_state(state, control.double(), scenario)
        return torch.where(after[:, :1] > 1, state, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        return super().perceived(state, scenario).float()


def test_a_state_of_another_type_that_stays_as_it_is_is_seen() -> None:
    """Who stands before the wall is in an endless loop, of which the rest is only counted."""
    actions, walks = walking_actions(), Walks(torch.tensor([0.5, -1.0]), torch.ones(2))
    graphs = chain(actions, "Aim", "Step", speed=0.25)
    found, wanted = (
        way(graphs, actions, Precise(walks), (200, 400)) for way in (waiting, in_torch)
    )
    assert found.state.dtype == torch.float64
    assert found.state[0, :, 0].tolist() == [1.0, 1.0]
    assert torch.equal(found.state, wanted.state)
    assert torch.equal(found.transitions, wanted.transitions)
    assert found.executed <= wanted.executed < 40
