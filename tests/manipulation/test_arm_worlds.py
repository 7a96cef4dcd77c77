"""Worlds of an arm: which episodes go on, what is counted, and what states and percepts hold."""

from dataclasses import replace
from importlib.metadata import version

import pytest
import torch
from arms import fetch, meta_world
from finger import Finger, Hasty, control

from cgtorch.domains.domain import Specialists
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.manipulation.arm import Arm, place_names
from cgtorch.manipulation.domain import Manipulation
from cgtorch.manipulation.settings import ManipulationSettings
from cgtorch.manipulation.simulator import CLOSER, CLOSEST, SEEN, SOLVED, STEPS, Simulator
from cgtorch.manipulation.world import ArmWorld, Simulators, Starts

ARM = Arm((*place_names("hand"), "grip", "time"), (), (0.0, 0.0, 0.0))


def made(task: str) -> Simulator:
    return (Hasty if task == "hasty" else Finger)(task)


def world_of(task: str = "touch", seeds: tuple[int, ...] = (0,), more: int = 0) -> ArmWorld:
    """A world with states that have room for more numbers."""
    simulators = Simulators(made, (task,))
    scenarios = Starts(torch.zeros(len(seeds), dtype=torch.long), torch.tensor(seeds).long())
    return ArmWorld(scenarios, simulators, ARM, simulators[0].size + more, 0)


def begun(world: ArmWorld) -> Lanes:
    return start_lanes(world, torch.arange(len(world.scenarios)), 0, 0)


def waiting(world: ArmWorld, lanes: Lanes, steps: int) -> Lanes:
    """The lanes after the hand stayed so many steps where it is, out of reach of success."""
    stay = torch.tensor(control(0.0, limit=steps, near=0.0))[None].expand(len(lanes), -1)
    return world.step(lanes, stay)[0]


@pytest.mark.parametrize(("steps", "over"), [(9, False), (10, True), (11, True)])
def test_a_search_gives_up_after_so_many_steps_without_coming_closer(
    steps: int, over: bool
) -> None:
    world = world_of("hasty")
    lanes = waiting(world.hurried(), begun(world), steps)
    assert world.over(lanes).tolist() == [over]
    assert lanes.state[0, STEPS] == (40 if over else steps)
    assert not world.succeeded(lanes.state).any()
    lanes = waiting(world, begun(world), steps)
    assert not world.over(lanes).any()
    assert lanes.state[0, STEPS] == steps


def test_who_came_closer_has_more_time() -> None:
    world = world_of("hasty").hurried()
    near = torch.tensor(control(0.5, limit=1))[None]
    lanes = world.step(waiting(world, begun(world), 8), near)[0]
    assert lanes.state[0, [STEPS, CLOSER]].tolist() == [9, 9]
    assert not world.over(waiting(world, lanes, 9)).any()
    assert world.over(waiting(world, lanes, 10)).all()


def test_who_succeeds_is_not_given_up() -> None:
    """Nor who may take any time."""
    world = world_of("hasty").hurried()
    world._simulators[0].told = -1.0  # type: ignore[attr-defined]  # it never comes closer
    there = torch.tensor(control(0.1, limit=30, speed=0.1))[None]
    lanes = world.step(begun(world), there)[0]
    assert lanes.state[0, SOLVED] == 1
    assert 10 < lanes.state[0, STEPS] < 40
    patient = world_of().hurried()
    assert not patient.over(waiting(patient, begun(patient), 39)).any()
    assert patient.over(waiting(patient, begun(patient), 40)).all()


def test_steps_are_counted_as_asked_and_as_simulated() -> None:
    world = world_of(seeds=(1, 2))
    lanes = begun(world)
    for _ in range(2):
        waiting(world, lanes, 5)
    assert world.asked == Asked(steps=20, simulated=10)
    assert world_of().asked == Asked()


def test_room_that_a_task_does_not_need_is_zero() -> None:
    lanes = begun(world_of(seeds=(1, 2), more=3))
    assert lanes.state.shape == (2, Finger().size + 3)
    assert lanes.state[:, SEEN + 1].tolist() == [0.01, 0.02]
    assert not lanes.state[:, -3:].any()


def test_a_world_without_starts() -> None:
    world = world_of(seeds=())
    lanes = begun(world)
    assert lanes.percept.shape == (0, 5)
    assert world.over(lanes).shape == (0,)


@pytest.mark.parametrize(("closest", "value"), [(-1.0, 0.0), (0.4, 0.18), (1.0, 0.45), (3.0, 0.45)])
def test_what_is_not_solved_is_worth_its_share(closest: float, value: float) -> None:
    world = world_of()
    lanes = begun(world)
    lanes.state[0, CLOSEST] = closest
    assert world.success(lanes)[1].tolist() == pytest.approx([value])
    lanes.state[0, SOLVED] = 1
    assert world.success(lanes)[1].tolist() == [1]


def test_percepts_tell_how_much_of_the_time_is_over() -> None:
    world = world_of(seeds=(2,))
    lanes = waiting(world, begun(world), 10)
    assert lanes.percept.tolist() == [pytest.approx([0, 0, 0, -1, 0.25], abs=0.02)]
    assert world.percept_size == 5


def test_the_fields_of_a_control_have_their_limits() -> None:
    limits = {field.name: (field.low, field.high) for field in meta_world().control}
    assert limits.pop("gripper") == (-1, 1)
    assert limits.pop("speed") == (0, 1)
    assert set(limits.values()) == {(-torch.inf, torch.inf)}
    assert list(limits) == ["x", "y", "z", "low-level steps", "near"]


@pytest.mark.parametrize("domain", [meta_world(), fetch()])
def test_a_domain_of_an_arm_says_what_a_run_is_made_with(domain: Manipulation) -> None:
    packages = domain.package, "mujoco"
    made_with = domain.files(domain).made_with()  # type: ignore[call-arg]
    assert made_with == {name: version(name) for name in packages}
    usual, own = Specialists(), domain.specialists
    assert own == replace(usual, group=own.group, team=own.team, stall=own.stall)
    assert own.group > usual.group  # episodes of arms are few, short and mostly alike
    assert own.team > usual.team
    assert own.stall < usual.stall
    assert domain.models is None


def test_percepts_tell_a_task_or_hide_it() -> None:
    with pytest.raises(SettingsError, match="task_id"):
        ManipulationSettings(task_id="perhaps")


def test_actions_are_named_after_the_places_they_go_to() -> None:
    single = ["Shift", "Pick", "Push", "Drag", "PushTo", "Hit", "Open", "Close"]
    own = ["ReachObject", "ReachGoal", "CarryGoal", "InsertGoal", "Place", *single, "Wait"]
    assert list(fetch("FetchReach-v4").actions().names) == [*own, "Branch"]
    assert list(fetch("FetchPickAndPlace-v4").actions().names) == [*own, "Branch"]
    own.remove("PushTo")
    assert list(fetch().actions().names) == [*own, "Steer", "Branch"]
    assert list(meta_world().actions().names) == [
        "ReachObject", "ReachOther", "ReachGoal", "CarryOther", "CarryGoal", "InsertOther",
        "InsertGoal", "Place", *single, "Branch",
    ]  # fmt: skip
