"""The standard worlds do what those of the field do: the same steps, rewards and ends."""

import math
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from standard.cards import CARDS, SUITS
from standard.double_pole import CHALLENGES
from standard.task import OVER, RETURN, STEPS, Starts, Task, starts
from standard.tasks import TASKS
from torch import Tensor

from cgtorch.ground.dry_run import check_environment
from cgtorch.ground.environment import Lanes, start_lanes

GYMNASIUM = {
    "cartpole": "CartPole-v1",
    "cartpole_no_velocities": "CartPole-v1",
    "acrobot": "Acrobot-v1",
    "acrobot_no_velocities": "Acrobot-v1",
    "mountain_car_continuous": "MountainCarContinuous-v0",
    "pendulum": "Pendulum-v1",
    "pendulum_no_velocity": "Pendulum-v1",
}
OWN = sorted(TASKS.keys() - {"lunar_lander"})
CLOSE = 1e-6
FREE = dict.fromkeys(
    ("acrobot", "acrobot_no_velocities", "cartpole", "cartpole_no_velocities"), 150
)
"""Steps in which what differs in the last digit stays small, although nothing holds it back.

After that, theirs goes on from our state in each step.
"""


def drawn(count: int) -> Starts:
    return starts(count, torch.Generator().manual_seed(0))


def begun(world: Any, count: int) -> Lanes:
    return start_lanes(world, torch.arange(count), 0, 0)


def random_controls(task: Task, count: int, steps: int) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return 2.4 * torch.rand(steps, count, task.outputs, generator=generator) - 1.2


def lively(name: str, state: Tensor) -> Tensor:
    """Controls that get somewhere: up the hill, up with the tip, or on balancing."""
    signal = {
        "Acrobot-v1": state[:, 2],
        "MountainCarContinuous-v0": state[:, 1],
        "Pendulum-v1": state[:, 1],
    }.get(GYMNASIUM[name], state[:, 2] + state[:, 3] + 0.1 * state[:, 1] + 0.05 * state[:, 0])
    toward = signal.sign()[:, None].float()
    size = TASKS[name].outputs
    return toward if size == 1 else toward * torch.linspace(-1, 1, size)


def action(name: str, control: Tensor) -> Any:
    """What Gymnasium is given for a control."""
    if TASKS[name].discrete:
        return int(control.argmax())
    torque = control.clamp(-1, 1).double().numpy()
    return 2 * torque if GYMNASIUM[name] == "Pendulum-v1" else torque.astype(np.float32)


def set_state(name: str, environment: Any, state: Tensor) -> None:
    values = state[:STEPS].numpy().copy()
    wanted = np.float32 if name == "mountain_car_continuous" else np.float64
    environment.unwrapped.state = values.astype(wanted)


@pytest.mark.parametrize("name", GYMNASIUM)
def test_episodes_are_gymnasiums(name: str) -> None:
    task, count = TASKS[name], 8
    lanes = begun(world := task.world(drawn(count)), count)
    theirs = [gymnasium.make(GYMNASIUM[name], disable_env_checker=True) for _ in range(count)]
    for lane, environment in enumerate(theirs):
        environment.reset(seed=lane)
        set_state(name, environment, lanes.state[lane])
    gained, over = torch.zeros(count, dtype=torch.float64), torch.zeros(count, dtype=torch.bool)
    for step, control in enumerate(random_controls(task, count, task.most_steps)):
        control[::2] = lively(name, lanes.state)[::2]
        lanes, _ = world.step(lanes, control)
        for lane in (~over).nonzero()[:, 0].tolist():
            _, reward, done, late, _ = theirs[lane].step(action(name, control[lane]))
            gained[lane] += reward
            over[lane] = done or late
            there = np.array(theirs[lane].unwrapped.state)
            assert np.abs(there - lanes.state[lane, :STEPS].numpy()).max() <= CLOSE
            if step >= FREE.get(name, task.most_steps):
                set_state(name, theirs[lane], lanes.state[lane])
        assert torch.equal(over, lanes.state[:, OVER] > 0)
        torch.testing.assert_close(gained, lanes.state[:, RETURN], rtol=0, atol=CLOSE)
    assert over.all()


@pytest.mark.parametrize("name", GYMNASIUM)
def test_percepts_are_gymnasiums_but_for_their_scale(name: str) -> None:
    task = TASKS[name]
    lanes = begun(task.world(drawn(1)), 1)
    environment: Any = gymnasium.make(GYMNASIUM[name], disable_env_checker=True)
    environment.reset(seed=0)
    set_state(name, environment, lanes.state[0])
    seen = environment.step(action(name, torch.zeros(task.outputs)))[0]
    percept = task.world(drawn(1)).step(lanes, torch.zeros(1, task.outputs))[0].percept[0].double()
    scale = {
        "cartpole": [2.4, 2, 0.21, 2],
        "cartpole_no_velocities": [2.4, 0.21],
        "acrobot": [1, 1, 1, 1, 4 * math.pi, 9 * math.pi],
        "mountain_car_continuous": [0.9, 0.07],
        "pendulum": [1, 1, 8],
    }.get(name, [1.0] * task.inputs)
    back = percept * torch.tensor(scale)
    back[0] -= 0.3 if name == "mountain_car_continuous" else 0
    expected = seen[::2] if name == "cartpole_no_velocities" else seen[: len(scale)]
    torch.testing.assert_close(back, torch.from_numpy(expected).double(), rtol=0, atol=2e-5)


def test_the_narrow_cart_goes_on_with_its_last_force_on_a_shorter_track() -> None:
    """As the cart of Gymnasium that is pushed likewise, until it is 1 m from the middle."""
    scenarios, left, again, right = drawn(1), *torch.eye(3)
    narrow, wide = (TASKS[name] for name in ("narrow_cartpole_no_velocities", "cartpole"))
    worlds = narrow.world(scenarios), wide.world(scenarios)
    lanes, theirs = (begun(world, 1) for world in worlds)
    signs = (again, -1), (right, 1), (again, 1), (left, -1), (right, 1), (again, 1), (again, 1)
    for step, (control, sign) in enumerate(signs):
        lanes, _ = worlds[0].step(lanes, control[None])
        theirs, _ = worlds[1].step(theirs, torch.tensor([[0.0, sign]]))
        assert torch.equal(lanes.state[0, :4], theirs.state[0, :4]), step
    seen = lanes.state[0, [0, 2]] / torch.tensor([1, 0.2094384], dtype=torch.float64)
    torch.testing.assert_close(lanes.percept[0].double(), seen, rtol=1e-6, atol=0)
    for place in (0.99, 1.01):
        state = begun(worlds[0], 1).state
        state[0, :4] = torch.tensor([place, 0, 0, 0])
        assert bool(worlds[0].next_state(state, right[None], torch.arange(1))[0, OVER]) == (
            place > 1
        )


def test_starts_are_spread_as_gymnasiums() -> None:
    ranges = {
        "cartpole": [(-0.05, 0.05)] * 4,
        "acrobot": [(-0.1, 0.1)] * 4,
        "mountain_car_continuous": [(-0.6, -0.4), (0.0, 0.0)],
        "pendulum": [(-math.pi, math.pi), (-1.0, 1.0)],
    }
    for name, bounds in ranges.items():
        state = begun(TASKS[name].world(drawn(4000)), 4000).state[:, :STEPS]
        low, high = torch.tensor(bounds, dtype=torch.float64).unbind(1)
        slack = 0.005 * (high - low) + 1e-7
        for found, bound in ((state.amin(0), low), (state.amax(0), high)):
            assert ((found - bound).abs() <= slack).all()
        assert ((state.mean(0) - (low + high) / 2).abs() <= 0.02 * (high - low) + 1e-7).all()


def test_thresholds_and_lengths_are_gymnasiums() -> None:
    for name, theirs in {**GYMNASIUM, "lunar_lander": "LunarLander-v3"}.items():
        spec = gymnasium.spec(theirs)
        assert TASKS[name].most_steps == spec.max_episode_steps
        assert spec.reward_threshold in (TASKS[name].solved, None)


@pytest.mark.parametrize("name", TASKS)
def test_worlds_are_what_tasks_say(name: str) -> None:
    task = TASKS[name]
    world = task.world(drawn(3))
    check_environment(world)
    assert task.name == name
    assert (world.percept_size, world.control_size) == (task.inputs, task.outputs)


def test_worlds_of_challenges_are_worlds() -> None:
    for challenge in CHALLENGES:
        check_environment(challenge.world())


@pytest.mark.parametrize("name", OWN)
def test_starts_and_steps_of_a_lane_are_its_own(name: str) -> None:
    task, count = TASKS[name], 13
    scenarios = drawn(count)
    several, alone = task.world(scenarios), task.world(scenarios[3:4])
    together, single = begun(several, count), begun(alone, 1)
    for control in random_controls(task, count, 60):
        assert torch.equal(together.state[3], single.state[0])
        assert torch.equal(together.percept[3], single.percept[0])
        together, _ = several.step(together, control)
        single, _ = alone.step(single, control[3:4])


@pytest.mark.parametrize("name", OWN)
def test_an_episode_that_is_over_stays_as_it_is(name: str) -> None:
    task, count = TASKS[name], 2
    lanes = begun(world := task.world(drawn(count)), count)
    for control in random_controls(task, count, min(task.most_steps, 1000)):
        lanes, _ = world.step(lanes, control)
    assert world.over(lanes).all()
    assert not name.startswith("double_pole") or (lanes.state[:, STEPS] < 100).all()
    assert (lanes.state[:, STEPS] <= task.most_steps).all()
    further, _ = world.step(lanes, torch.ones(count, task.outputs))
    assert torch.equal(lanes.state, further.state)
    assert torch.equal(lanes.percept, further.percept)


def test_a_lander_is_gymnasiums() -> None:
    task, scenarios = TASKS["lunar_lander"], drawn(2)
    lanes = begun(world := task.world(scenarios), 2)
    theirs: Any = gymnasium.make("LunarLander-v3", disable_env_checker=True)
    theirs.reset(seed=int(scenarios.seed[1]))
    gained, over = 0.0, False
    for control in random_controls(task, 2, task.most_steps):
        lanes, _ = world.step(lanes, control)
        if not over:
            _, reward, done, late, _ = theirs.step(int(control[1].argmax()))
            gained, over = gained + float(reward), done or late
    assert over
    assert world.over(lanes).all()
    assert float(world.returns(lanes)[1]) == pytest.approx(gained)


def played(name: str, decide: Callable[[list[int]], int]) -> tuple[list[int], float, float]:
    """The suits that are shown to a player who decides by them, the return, and that by hand."""
    lanes = begun(world := TASKS[name].world(drawn(1)), 1)
    shown, by_hand = [int(lanes.percept[0].argmax())], 0.0
    for _ in range(CARDS - 1):
        assert lanes.state[0, OVER] == 0
        named = decide(shown)
        if name == "repeat_first":
            by_hand += (1 if named == shown[0] else -1) / 51
        elif len(shown) >= 4:
            by_hand += (1 if named == shown[-4] else -1) / 48
        lanes, _ = world.step(lanes, torch.eye(SUITS)[named : named + 1])
        assert lanes.percept.sum() == 1
        shown.append(int(lanes.percept[0].argmax()))
    assert lanes.state[0, OVER] == 1
    return shown, float(lanes.state[0, RETURN]), by_hand


DECISIONS = {
    "first": lambda shown: shown[0],
    "previous": lambda shown: shown[-4] if len(shown) >= 4 else 0,
    "always the same": lambda shown: 2,
    "what is seen": lambda shown: shown[-1],
}


@pytest.mark.parametrize("decision", DECISIONS)
@pytest.mark.parametrize("name", ["repeat_first", "repeat_previous"])
def test_card_games_follow_their_rules(name: str, decision: str) -> None:
    shown, gained, by_hand = played(name, DECISIONS[decision])
    assert sorted(shown) == [suit for suit in range(SUITS) for _ in range(CARDS // SUITS)]
    assert gained == pytest.approx(by_hand, abs=1e-12)
    if name.endswith(decision):
        assert gained == pytest.approx(1)
    assert abs(gained) <= 1 + 1e-12
