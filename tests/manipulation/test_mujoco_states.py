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
    """A ball on a rail, with a mark that is elsewhere at each start and numbers of its own."""

    def __init__(self, hidden: bool = False) -> None:
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.data = mujoco.MjData(self.model)
        self.count, self.last, self.wind = 0, None, 0.0
        self.hidden: list[float] = []
        self.hides = hidden

    def reset(self, seed: int) -> np.ndarray:
        mujoco.mj_resetData(self.model, self.data)
        random = np.random.default_rng(seed)
        self.model.body("mark").pos[:] = random.uniform(-1, 1, 3)
        self.wind = float(random.uniform(-1, 1))
        self.count, self.last = 0, None
        self.hidden.clear()
        return self.seen()

    def act(self, number: int) -> np.ndarray:
        force = np.sin(number) + self.wind + (0.0 if self.last is None else 0.1 * self.last[0])
        if self.hides:
            self.hidden.append(force)
            force += len(self.hidden)
        self.data.ctrl[0] = force + 0.01 * self.count
        mujoco.mj_step(self.model, self.data)
        self.count += 1
        self.last = self.data.qpos.copy()
        return self.seen()

    def seen(self) -> np.ndarray:
        return np.array(
            [*self.data.qpos, *self.data.qvel, self.count, *self.model.body("mark").pos]
        )


def states_of(slider: Slider) -> MujocoStates:
    return MujocoStates(slider, slider.reset, slider.act)


def test_an_episode_continues_from_any_state_of_any_start() -> None:
    slider = Slider()
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


def test_a_start_that_was_forgotten_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cgtorch.manipulation.mujoco_states.MOST_STARTS", 2)
    slider = Slider()
    states = states_of(slider)
    first, seen = states.start(3)
    for seed in (4, 5, 6):
        states.start(seed)
    states.write(first, 3)
    assert np.array_equal(slider.seen(), seen)
    assert np.array_equal(states.start(3)[0], first, equal_nan=True)


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
