"""States of MuJoCo environments: an episode continues from any of them to the bit."""

from typing import Any

import mujoco
import numpy as np
import pytest
from arms import fetch, meta_world

from cgtorch.ground.errors import WorldError
from cgtorch.manipulation.mujoco_states import MujocoStates

XML = """
<mujoco>
  <worldbody>
    <body name="ball"><joint name="x" type="slide" axis="1 0 0" damping="0.1"/>
      <geom size="0.1"/></body>
    <body name="mark" pos="0 0 1"><geom size="0.1" contype="0"/></body>
  </worldbody>
  <actuator><motor joint="x"/></actuator>
</mujoco>
"""


class Slider:
    """A ball on a rail, with a mark that is elsewhere at each start and numbers of its own.

    What it keeps `hidden`, in a list, moves it after some steps. If it `lags`, so does the place
    that MuJoCo computed before the last step.
    """

    def __init__(self, hidden: bool = False, lags: bool = False) -> None:
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.data = mujoco.MjData(self.model)
        self.count, self.wind = 0, 0.0
        self.last: Any = None
        self.fastest: float | None = None
        self.hidden: list[float] = []
        self.hides, self.lags = hidden, lags
        self.moved, self.begun = False, list[int]()

    def reset(self, seed: int) -> np.ndarray:
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        random = np.random.default_rng(seed)
        self.model.body("mark").pos[:] = random.uniform(-1, 1, 3)
        self.wind = float(random.uniform(-1, 1))
        self.count, self.last, self.moved, self.fastest = 0, None, False, None
        self.hidden.clear()
        self.begun.append(seed)
        return self.seen()

    def act(self, number: int) -> np.ndarray:
        force = np.sin(number) + self.wind + (0.0 if self.last is None else 0.1 * self.last[0])
        if self.hides:
            self.hidden.append(force)
            force += len(self.hidden) * (self.count > 18)
        if self.lags:
            force += 9 * self.data.body("ball").xpos[0]
        self.data.ctrl[0] = force + 0.01 * self.count
        mujoco.mj_step(self.model, self.data)
        self.count += 1
        self.last, self.moved = self.data.qpos.copy(), True
        self.fastest = max(self.fastest or 0.0, abs(float(self.data.qvel[0])))
        return self.seen()

    def seen(self) -> np.ndarray:
        return np.array(
            [*self.data.qpos, *self.data.qvel, self.count, *self.model.body("mark").pos]
        )


def states_of(slider: Slider) -> MujocoStates:
    return MujocoStates(slider, slider.reset, slider.act)


@pytest.mark.parametrize("lags", [False, True])
def test_an_episode_continues_from_any_state_of_any_start(lags: bool) -> None:
    slider = Slider(lags=lags)
    states = states_of(slider)
    ways: dict[int, tuple[list[Any], list[np.ndarray]]] = {}
    for seed in (3, 4, 5):
        state, first = states.start(seed)
        assert np.array_equal(first, slider.reset(seed))
        states.write(state, seed)
        ways[seed] = [state], [first]
        for number in range(30):
            ways[seed][1].append(slider.act(number))
            ways[seed][0].append(states.read())
    for seed, number in ((3, 7), (5, 0), (4, 29), (3, 29), (5, 12)):
        states.write(ways[seed][0][number], seed)
        assert np.array_equal(slider.act(number), ways[seed][1][number + 1])
        assert np.array_equal(states.read(), ways[seed][0][number + 1])


def test_of_a_model_only_what_differs_between_starts_is_kept() -> None:
    assert states_of(Slider())._fixed == ["body_pos"]


def test_a_start_that_was_forgotten_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cgtorch.manipulation.mujoco_states.MOST_STARTS", 2)
    slider = Slider()
    states = states_of(slider)
    slider.begun.clear()
    first, seen = states.start(3)
    for seed in (4, 3, 5, 4, 5):
        states.start(seed)
    assert slider.begun == [3, 4, 5]
    states.write(first, 3)
    assert slider.begun == [3, 4, 5, 3]
    assert np.array_equal(slider.seen(), seen)
    assert np.array_equal(states.start(3)[0], first, equal_nan=True)


def test_a_new_start_does_not_disturb_an_episode_that_goes_on() -> None:
    slider = Slider()
    states = states_of(slider)
    states.write(states.start(3)[0], 3)
    slider.act(0)
    state, mark = states.read(), slider.model.body("mark").pos.copy()
    following = slider.act(1)
    states.start(9)
    assert not np.array_equal(slider.model.body("mark").pos, mark)
    states.write(state, 3)
    assert np.array_equal(slider.act(1), following)


def test_numbers_of_its_own_stay_what_they_are() -> None:
    """None, whole numbers, truth values, arrays, and what was None at the start."""
    slider = Slider()
    states = states_of(slider)
    begun = states.start(3)[0]
    for number in range(3):
        slider.act(number)
    state, last, fastest = states.read(), slider.last, slider.fastest
    states.write(begun, 3)
    assert (slider.count, slider.last, slider.moved, slider.fastest) == (0, None, False, None)
    states.write(state, 3)
    assert (slider.count, slider.moved, slider.fastest) == (3, True, fastest)
    assert [type(x) for x in (slider.count, slider.moved, slider.fastest)] == [int, bool, float]
    assert np.array_equal(slider.last, last)
    assert slider.last.dtype == np.float64


def test_a_state_that_was_set_is_there_at_once() -> None:
    """To the bit, with the places that follow from it, and what the next step begins with."""
    slider = Slider()
    states = states_of(slider)
    states.write(states.start(3)[0], 3)
    for number in range(5):
        slider.act(number)
    state = states.read()
    for number in range(5):
        slider.act(number)
    states.write(state, 3)
    assert np.array_equal(states.read(), state)
    assert slider.data.body("ball").xpos[0] == slider.data.qpos[0]


@pytest.mark.parametrize(("lags", "more"), [(False, 0), (True, 3 * (3 + 4))])
def test_places_that_lag_behind_belong_to_the_state(lags: bool, more: int) -> None:
    """Those and turns of three bodies: the world, the ball and the mark."""
    states = states_of(Slider(lags=lags))
    size = mujoco.mj_stateSize(states.model, mujoco.mjtState.mjSTATE_INTEGRATION)
    own = 4  # the count, the last place, whether it moved, the fastest
    assert states.size == len(states.read()) == size + own + more


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(WorldError, match="Slider does not repeat itself"):
        states_of(Slider(hidden=True))


@pytest.mark.parametrize("domain", [meta_world("door-open-v3"), fetch("FetchSlide-v4")])
def test_benchmarks_repeat_themselves_to_the_bit(domain: Any) -> None:
    """Also after another start, with fixed bodies elsewhere, has been there in between."""
    simulator = domain.simulators[0]
    rows = [simulator.start(seed) for seed in (1, 2)]
    control = np.array([*simulator.perceive(simulator.states.start(1)[1])[:3], 1.0, 9, 1.0, 0.0])
    control[:2] += 0.1
    once = [simulator._moved(row, seed, control) for row, seed in zip(rows, (1, 2), strict=True)]
    again = [simulator._moved(row, seed, control) for row, seed in zip(rows, (1, 2), strict=True)]
    assert all(map(np.array_equal, once, again))
    assert not np.array_equal(*once)
