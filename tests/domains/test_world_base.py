"""The base class of worlds: what it makes of four methods that say what a world is."""

from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rail import Cart, Rail
from support import seeded
from torch import Tensor

from cgtorch import World
from cgtorch.ground.dry_run import check_environment
from cgtorch.ground.environment import Environment, Rewarded, start_lanes

CONTROL = st.tuples(*[st.floats(-9, 9, width=32) | st.sampled_from([torch.nan, torch.inf])] * 3)


def rail(count: int, seed: int = 0) -> Rail:
    return Rail(Cart().draw("any", count, seeded(seed)))


def test_it_is_an_environment_without_rewards() -> None:
    world = rail(3)
    assert isinstance(world, Environment)
    assert not isinstance(world, Rewarded)
    assert (world.num_scenarios, world.percept_size, world.control_size) == (3, 4, 3)
    check_environment(world)


def test_the_size_of_a_percept_is_known_without_scenarios() -> None:
    assert rail(0).percept_size == 4
    assert rail(0).num_scenarios == 0


def test_a_percept_is_the_state_as_floats_unless_it_is_said_otherwise() -> None:
    class Blinkered(Rail):
        def first_state(self, scenario: Tensor) -> Tensor:
            return super().first_state(scenario).double()

        def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
            return torch.stack([state[:, 0], scenario.to(state)], 1)

    scenarios = Cart().draw("any", 3, seeded(0))
    order = torch.tensor([2, 0])
    state, percept = Rail(scenarios).start(order)
    assert torch.equal(percept, state)
    assert torch.equal(state[:, 0], scenarios.place[order])
    world = Blinkered(scenarios)
    state, percept = world.start(order)
    assert state.dtype == torch.float64
    assert percept.dtype == torch.float32
    assert percept[:, 1].tolist() == [2, 0]
    lanes = start_lanes(world, order, 0, 0)
    after, _ = world.step(lanes, torch.ones(2, 3))
    assert after.state.dtype == torch.float64
    assert torch.equal(after.percept[:, 0], after.state[:, 0].float())
    assert after.percept[:, 1].tolist() == [2, 0]
    check_environment(world)


@given(st.lists(CONTROL, min_size=1, max_size=6), st.integers(0, 2**31))
def test_a_control_that_is_no_number_changes_nothing(
    controls: list[tuple[float, ...]], seed: int
) -> None:
    world, n = rail(len(controls), seed), len(controls)
    lanes, given_ = start_lanes(world, torch.arange(n), 2, 1), torch.tensor(controls)
    after, done = world.step(lanes, given_)
    assert torch.equal(done, given_.isfinite().all(1))
    assert torch.equal(after.state[~done], lanes.state[~done])
    assert torch.equal(after.percept[~done], lanes.percept[~done])
    wanted = world.next_state(lanes.state[done], given_[done], lanes.scenario[done])
    assert torch.equal(after.state[done], wanted)
    assert torch.equal(after.percept[done], wanted)
    for name in ("message", "has_message", "memory", "scenario", "step"):
        assert getattr(after, name) is getattr(lanes, name)


@given(st.lists(CONTROL, min_size=2, max_size=6), st.integers(0, 2**31))
def test_lanes_do_not_know_of_one_another(controls: list[tuple[float, ...]], seed: int) -> None:
    world, n = rail(len(controls), seed), len(controls)
    lanes = start_lanes(world, torch.arange(n), 0, 0)
    together, done = world.step(lanes, torch.tensor(controls))
    for row in range(n):
        mine = torch.tensor([row])
        alone, one = world.step(lanes.rows(mine), torch.tensor(controls)[mine])
        assert not alone.differs(together.rows(mine)).any()
        assert torch.equal(one, done[mine])


def test_looking_changes_nothing_and_success_is_one_or_nought() -> None:
    world = rail(40)
    lanes = start_lanes(world, torch.arange(40), 0, 0)
    assert world.observe(lanes) is lanes
    after, chance = world.success(lanes)
    assert after is lanes
    assert chance.dtype == torch.float32
    assert torch.equal(chance == 1, world.succeeded(lanes.state))
    assert set(chance.tolist()) == {0, 1}


@pytest.mark.parametrize("missing", ["first_state", "next_state", "succeeded", "control_size"])
def test_what_is_missing_is_told_at_once(missing: str) -> None:
    methods = {n: vars(Rail)[n] for n in ("first_state", "next_state", "succeeded", "control_size")}
    del methods[missing]
    unfinished: Any = type("Unfinished", (World,), methods)
    with pytest.raises(TypeError, match=missing):
        unfinished(Cart().draw("any", 1, seeded(0)))
