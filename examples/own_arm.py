"""An arm of your own as a domain: here a hand on three slides that pushes a puck to a goal.

    cgtorch-train --domain examples.own_arm:Gantry --run-dir runs/gantry
    cgtorch-evaluate runs/gantry --domain examples.own_arm:Gantry
    cgtorch-view runs/gantry --domain examples.own_arm:Gantry --film gantry.webp

The environment knows nothing of cgtorch. It has MuJoCo's `model` and `data`, a `reset` with a seed,
and a `step`, as environments of Gymnasium have. The rest says what of it an arm perceives and does.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cgtorch.domains.settings import option
from cgtorch.ground.errors import DomainError
from cgtorch.manipulation.arm import place_names
from cgtorch.manipulation.domain import Manipulation
from cgtorch.manipulation.mujoco_states import MujocoStates
from cgtorch.manipulation.settings import ManipulationSettings
from cgtorch.manipulation.simulator import Floats, Simulator

SPEED = 0.5  # m/s
THERE = 0.02  # m from the goal
XML = """
<mujoco>
  <visual><headlight ambient="0.4 0.4 0.4"/></visual>
  <worldbody>
    <geom type="plane" size="2 2 0.1" rgba="0.8 0.75 0.65 1"/>
    <body name="hand" pos="0 -0.2 0.15" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1" range="-0.13 0.2" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.015" mass="0.5" rgba="0.2 0.3 0.8 1"/>
      <site name="hand"/>
    </body>
    <body name="puck" pos="0 0 0.02">
      <joint name="puck x" type="slide" axis="1 0 0" damping="0.5" frictionloss="0.5"/>
      <joint name="puck y" type="slide" axis="0 1 0" damping="0.5" frictionloss="0.5"/>
      <geom type="cylinder" size="0.03 0.02" mass="0.1" rgba="0.8 0.2 0.2 1"/>
    </body>
    <site name="goal" type="cylinder" size="0.02 0.001" rgba="0.1 0.7 0.2 1"/>
  </worldbody>
  <actuator>
    <velocity joint="x" kv="50"/><velocity joint="y" kv="50"/><velocity joint="z" kv="50"/>
  </actuator>
</mujoco>
"""


class Table:
    """The environment: somebody's own, which could be anything that MuJoCo simulates."""

    def __init__(self) -> None:
        """A table with a hand, a puck and a goal."""
        self.model: Any = mujoco.MjModel.from_xml_string(XML)
        self.data: Any = mujoco.MjData(self.model)

    def reset(self, seed: int) -> Floats:
        """Begin an episode; returns what is observed."""
        random = np.random.default_rng(seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[3:] = random.uniform(-0.1, 0.1, 2)
        self.model.site("goal").pos[:2] = random.uniform((-0.2, 0.15), (0.2, 0.3))
        mujoco.mj_forward(self.model, self.data)
        return self.observed()

    def step(self, action: Floats) -> Floats:
        """Move for 0.02 s with dx, dy and dz, each in [-1, 1]; returns what is observed."""
        self.data.ctrl[:] = SPEED * np.clip(action[:3], -1, 1)
        mujoco.mj_step(self.model, self.data, nstep=10)
        return self.observed()

    def observed(self) -> Floats:
        """The positions of hand, puck and goal, m."""
        puck, goal = self.data.body("puck").xpos, self.data.site("goal").xpos
        return np.concatenate([self.data.site("hand").xpos, puck, goal])


class TableSimulator(Simulator):
    """How the library asks the environment: starts, low-level steps, and what is seen."""

    seen = 9

    def __init__(self, task: str, horizon: int) -> None:
        """The only task."""
        super().__init__(horizon)
        self.table = Table()
        self.states = MujocoStates(self.table, self.table.reset, self._tried)

    def _tried(self, number: int) -> Floats:
        """Some step, to find out what changes within an episode."""
        return self.table.step(np.sin(np.arange(1, 5) * (number + 1.0)))

    def perceive(self, observation: Any) -> Floats:
        """See `Simulator.perceive`."""
        seen: Floats = observation
        return seen

    def hand(self) -> Floats:
        """See `Simulator.hand`."""
        place: Floats = self.table.data.site("hand").xpos
        return place

    def closeness(self, observation: Any) -> float:
        """See `Simulator.closeness`."""
        return float(np.exp(-5 * self._left(observation)))

    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool]:
        """See `Simulator.move`."""
        observation = self.table.step(action)
        return observation, self.closeness(observation), self._left(observation) < THERE

    def _left(self, observation: Floats) -> float:
        """The distance from the puck to the goal, m."""
        return float(np.linalg.norm((observation[6:] - observation[3:6])[:2]))


@dataclass(frozen=True)
class GantrySettings(ManipulationSettings):
    """The settings of an arm, with another task."""

    environment: str = option(
        "push", "The task.", "the run was made for it", when="There is only one here."
    )


class Gantry(Manipulation):
    """The domain: the names of what is seen, and of the places that primitives know."""

    settings_type = GantrySettings
    package = "mujoco"
    seen = (*place_names("hand"), *place_names("object"), *place_names("goal"))
    places = ("object", "goal")
    centre = (0.0, 0.1, 0.1)
    view = (60.0, -35.0, 0.8)
    make = TableSimulator

    @staticmethod
    def named(name: str) -> tuple[str, ...]:
        """The tasks of a name, of which each becomes a stage."""
        if name != "push":
            raise DomainError(f"a gantry has no task {name!r:.40}; give push")
        return (name,)
