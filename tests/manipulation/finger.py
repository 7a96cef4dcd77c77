"""A finger in MuJoCo that goes half of its way, up to 5 cm, in each low-level step."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from cgtorch.manipulation.mujoco_states import MujocoStates
from cgtorch.manipulation.simulator import SEEN, Floats, Simulator

XML = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="tip">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
      <joint type="slide" axis="0 0 1"/><geom size="0.01"/>
    </body>
  </worldbody>
</mujoco>
"""


class Finger(Simulator):
    """Comes close to success where x is `goal`, and notes what it is told.

    It stops at a wall, and looks every few steps. `told` is how close it is in place of the truth.
    """

    seen = 4  # position, grip
    gain = 10.0

    def __init__(self, task: str = "touch", horizon: int = 40) -> None:
        super().__init__(horizon)
        model = mujoco.MjModel.from_xml_string(XML)
        data = mujoco.MjData(model)
        self.environment: Any = SimpleNamespace(model=model, data=data, grip=0.0)
        self.actions = list[list[float]]()
        self.lasts = list[bool]()
        self.wall, self.every, self.goal, self.width = 9.0, 1, 0.1, 0.005
        self.told: float | None = None
        self.states = MujocoStates(self.environment, self._reset, self._tried)

    def _reset(self, seed: int) -> Floats:
        e = self.environment
        mujoco.mj_resetData(e.model, e.data)
        e.data.qpos[1] = 0.01 * seed
        mujoco.mj_forward(e.model, e.data)
        e.grip = 0.0
        return self._seen()

    def _tried(self, number: int) -> Floats:
        return self._acted(self.probing(number))

    def _acted(self, action: Floats) -> Floats:
        e = self.environment
        e.data.qpos[:] += 0.05 * action[:3]
        e.data.qpos[0] = min(e.data.qpos[0], self.wall)
        mujoco.mj_forward(e.model, e.data)
        e.grip = float(action[3])
        return self._seen()

    def _seen(self) -> Floats:
        return np.array([*self.environment.data.qpos, self.environment.grip])

    def perceive(self, observation: Any) -> Floats:
        return observation

    def hand(self) -> Floats:
        place: Floats = self.environment.data.body("tip").xpos
        return place

    def closeness(self, observation: Any) -> float:
        return (
            max(0.0, 1 - 10 * abs(observation[0] - self.goal)) if self.told is None else self.told
        )

    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool] | None:
        self.actions.append([round(x, 6) for x in action.tolist()])
        self.lasts.append(last)
        seen = self._acted(action)
        if not last and len(self.actions) % self.every:
            return None
        return seen, self.closeness(seen), abs(seen[0] - self.goal) < self.width


class Patient(Finger):
    """Is solved if it is at the last step."""

    at_the_end = True


class Hasty(Finger):
    """A search gives it up where it comes no closer in ten steps."""

    patience = 10


def control(
    x: float, y: float = 0.0, z: float = 0.0, grip: float = -1.0, limit: float = 9.0,
    speed: float = 1.0, near: float = 0.011,
) -> Floats:  # fmt: skip
    return np.array([x, y, z, grip, limit, speed, near])


def place(row: Floats) -> list[float]:
    """Where the finger is."""
    return [round(x, 6) for x in row[SEEN : SEEN + 3].tolist()]
