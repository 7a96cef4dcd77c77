"""A task as a Gymnasium environment, one step of which is one primitive.

Action spaces of this kind are those of RAPS (Dalal et al., "Accelerating Robotic Reinforcement
Learning via Parameterized Action Primitives", NeurIPS 2021) and MAPLE (Nasiriany et al.,
"Augmenting Reinforcement Learning with Behavior Primitives for Diverse Manipulation Tasks", ICRA
2022).
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray

from cgtorch.graphs import ActionSet
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.manipulation.domain import MOST_SEEDS, Manipulation
from cgtorch.manipulation.simulator import SOLVED, STEPS
from cgtorch.manipulation.world import ArmWorld, Starts
from robot_tasks.problem import deviation_of, grade

Floats = NDArray[np.float32]
WIDEST = 3.0  # standard deviations


class Primitives(gymnasium.Env[Floats, Floats]):
    """Episodes of the first task of a domain.

    An observation is the percept. The first numbers of an action are one for each primitive, of
    which the largest is taken. The others are its parameters, as many as any primitive has, in
    units of the standard deviations of new nodes of graphs. The reward is by how much the graded
    success has grown, and 1 more for success. An episode ends with success, and with its last
    low-level step; the percept tells the time, so that nothing is cut off.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  as Gymnasium has it
    lanes: Lanes
    world: ArmWorld

    def __init__(self, domain: Manipulation) -> None:
        """The environment of a domain, whose simulators go on counting."""
        self.domain = domain
        made = domain.primitives()
        self.actions = ActionSet(tuple(made), tuple(made.values()))
        shape = (len(made) + self.actions.parameter_capacity,)
        self.action_space = Box(-WIDEST, WIDEST, shape, dtype=np.float32)
        self.observation_space = Box(-np.inf, np.inf, (len(domain.percept),), dtype=np.float32)
        self._deviation = [deviation_of(module) for module in self.actions.actions]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode at a fresh start."""
        super().reset(seed=seed)
        drawn = torch.tensor([int(self.np_random.integers(MOST_SEEDS))])
        return self.begin(self.domain.world(Starts(torch.zeros_like(drawn), drawn))), {}

    def begin(self, world: ArmWorld) -> Floats:
        """Begin an episode at the start of a world; the observation."""
        self.world, width = world, self.actions.message_size
        self.lanes = start_lanes(world, torch.tensor([0]), width, _memory(self.actions))
        return self._observed()

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Carry out a primitive."""
        numbers = torch.from_numpy(np.clip(action, -WIDEST, WIDEST)).float()
        number, size = int(numbers[: len(self.actions)].argmax()), len(self.actions)
        deviation, before = self._deviation[number], self.lanes.state
        parameters = deviation * numbers[size : size + len(deviation)]
        module = self.actions.actions[number]
        self.lanes, _ = module(self.lanes, parameters[None], self.world)
        after = self.lanes.state
        solved = bool(after[0, SOLVED] > 0)
        reward = float(grade(after) - grade(before)) + solved
        over = solved or bool(after[0, STEPS] >= self.domain.settings.horizon)
        return self._observed(), reward, over, False, {"is_success": solved}

    def _observed(self) -> Floats:
        observation: Floats = self.lanes.percept[0].float().numpy().copy()
        return observation


def _memory(actions: ActionSet) -> int:
    """The size of the memory, of which all primitives share one part."""
    return max(module.memory_size for module in actions.actions)
