"""The base class of worlds: what it makes of four methods that say what a world is."""

from dataclasses import replace
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
from cgtorch.ground.errors import WorldError

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


class Keeper(Rail):
    """One that changes what it gets, and returns what it keeps and will change."""

    def first_state(self, scenario: Tensor) -> Tensor:
        self.kept = super().first_state(scenario)
        return self.kept

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        self.kept[:] = super().next_state(state, control, scenario)
        state.zero_()
        control.zero_()
        return self.kept

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        if not hasattr(self, "shown"):
            self.shown = torch.zeros(len(state), 4)
        self.shown[:] = state
        state.zero_()
        return self.shown

    def succeeded(self, state: Tensor) -> Tensor:
        found = super().succeeded(state)
        state.zero_()
        return found


@pytest.mark.parametrize("bad", [0.0, torch.nan])
def test_what_a_world_changes_and_keeps_is_its_own(bad: float) -> None:
    scenarios, order = Cart().draw("any", 2, seeded(0)), torch.arange(2)
    controls = [torch.full((2, 3), 0.5), torch.tensor([[0.3] * 3, [bad] * 3])]
    plain, keeper = Rail(scenarios), Keeper(scenarios)
    one, other = (start_lanes(world, order, 0, 0) for world in (plain, keeper))
    first = other
    for control in controls:
        one, _ = plain.step(one, control)
        other, _ = keeper.step(other, control.clone())
        assert not one.differs(other).any()
        assert torch.equal(plain.success(one)[1], keeper.success(other)[1])
    assert not start_lanes(plain, order, 0, 0).differs(first).any()


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_a_percept_that_is_not_finite_is_told_with_its_scenario_and_step(bad: float) -> None:
    class Broken(Rail):
        beyond = 0.75

        def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
            wrong = (scenario == 1) & (state[:, 0] > self.beyond)
            return torch.where(wrong[:, None] & (torch.arange(4) == 2), bad, state)

    drawn = Cart().draw("any", 3, seeded(0))
    scenarios = replace(drawn, place=torch.zeros(3), wind=torch.full((3,), 0.5))
    world = Broken(scenarios)
    lanes = start_lanes(world, torch.tensor([0, 1]), 0, 0)
    lanes, _ = world.step(lanes, torch.zeros(2, 3))
    message = f"Broken showed number 3 of its percept as {bad} in step 7;.* Its scenario 1 has "
    with pytest.raises(WorldError, match=f"{message}place=0.0, wind=0.5, lamp="):
        world.step(replace(lanes, step=lanes.step + 7), torch.zeros(2, 3))
    world.beyond = -1
    with pytest.raises(WorldError, match=f"percept as {bad} at its start; show finite numbers"):
        world.start(torch.tensor([2, 1]))


@pytest.mark.parametrize("method", ["next_state", "perceived"])
def test_numbers_that_become_more_are_told(method: str) -> None:
    class Growing(Rail):
        more = False

        def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
            after = super().next_state(state, control, scenario)
            return torch.cat([after, after], 1) if self.more and method == "next_state" else after

        def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
            return state[:, :4] if not self.more or method == "next_state" else state[:, :3]

    world = Growing(Cart().draw("any", 2, seeded(0)))
    lanes = start_lanes(world, torch.arange(2), 0, 0)
    world.more = True
    with pytest.raises(WorldError, match=r"Growing: a (state|percept) of shape \(2, 4\) became"):
        world.step(lanes, torch.ones(2, 3))


@pytest.mark.parametrize("missing", ["first_state", "next_state", "succeeded", "control_size"])
def test_what_is_missing_is_told_at_once(missing: str) -> None:
    methods = {n: vars(Rail)[n] for n in ("first_state", "next_state", "succeeded", "control_size")}
    del methods[missing]
    unfinished: Any = type("Unfinished", (World,), methods)
    with pytest.raises(TypeError, match=missing):
        unfinished(Cart().draw("any", 1, seeded(0)))
