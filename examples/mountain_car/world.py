"""The world: MountainCarContinuous-v0 itself, as an environment of batched lanes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor

from cgtorch.environment import Lanes, ScenarioBatch

ID = "MountainCarContinuous-v0"
PUSH = 10
"""Steps of the environment for which one push lasts."""

PERCEPT = ("position", "speed", "spent")
"""What the car perceives: where it is; how far it rolls at this speed during a push; what it has
spent on pushing, as a share of the 100 points that the flag is worth."""

VALLEY, ANYWHERE = (-0.6, -0.4), (-1.1, 0.4)
"""Positions to start at: the environment's own, and nearly all there are."""


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """Where episodes begin: what `env.reset` is given.

    Attributes:
        seed: (B,) long.
        between: (B, 2) lowest and highest position.
    """

    seed: Tensor
    between: Tensor


def draw_starts(count: int, generator: Generator, between: Sequence[float] = VALLEY) -> Starts:
    """Starts with random seeds."""
    seed = torch.randint(2**31, (count,), generator=generator)
    return Starts(seed, torch.tensor(between).expand(count, 2))


SPEC = gymnasium.spec(ID)
MOST_STEPS, SOLVED = int(SPEC.max_episode_steps or 0), float(SPEC.reward_threshold or 0)
"""When Gymnasium stops an episode (999 steps), and the points from which it is solved (90)."""


class MountainCar:
    """An `Environment`: each control is a force that is held for `PUSH` steps.

    A lane's state (n, 5) is all that an episode is: position, velocity, steps, points, and whether
    the environment has said that it is over. So one environment plays all of them in turn.
    """

    percept_size, control_size = len(PERCEPT), 1

    def __init__(self, starts: Starts):
        self.starts, self.num_scenarios = starts, len(starts)
        self._env = gymnasium.make(ID)
        self._car: Any = self._env.unwrapped

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        state = torch.zeros(len(scenario), 5, dtype=torch.float64)
        for row, number in enumerate(scenario.tolist()):
            state[row, :2] = torch.from_numpy(self._reset(number))
        return state, _percept(state)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`; an episode that is over takes no more pushes."""
        state = lanes.state.clone()
        goes_on = ~self.over(lanes) & (state[:, 2] < MOST_STEPS) & control.isfinite().all(1)
        for row in goes_on.nonzero()[:, 0].tolist():
            state[row] = self._pushed(state[row], int(lanes.scenario[row]), float(control[row, 0]))
        return replace(lanes, state=state, percept=_percept(state)), goes_on

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`: 1 at the flag with the points that Gymnasium calls solved."""
        return lanes, (self.over(lanes) & (lanes.state[:, 3] >= SOLVED)).to(lanes.percept)

    @staticmethod
    def over(lanes: Lanes) -> Tensor:
        """(n,) bool, whether the environment has ended the episode at the flag."""
        return lanes.state[:, 4] > 0

    def _reset(self, number: int) -> NDArray[np.float32]:
        low, high = self.starts.between[number].tolist()
        seed = int(self.starts.seed[number])
        return self._env.reset(seed=seed, options={"low": low, "high": high})[0]

    def _pushed(self, state: Tensor, number: int, force: float) -> Tensor:
        """The state (5,) after a push, as the environment plays it."""
        position, velocity, steps, points, over = state.tolist()
        if steps == 0:
            self._reset(number)
        else:
            # Gymnasium has no public way to go on from a state, but its environments keep it here.
            self._car.state = np.array([position, velocity], dtype=np.float32)
        for _ in range(PUSH):
            seen, reward, over, _, _ = self._env.step(np.array([force], dtype=np.float32))
            steps, points = steps + 1, points + float(reward)
            if over or steps == MOST_STEPS:
                break
        return state.new_tensor([*seen.tolist(), steps, points, over])


def _percept(state: Tensor) -> Tensor:
    """Percepts (n, 3) of states (n, 5)."""
    position, velocity, _, points, over = state.unbind(1)
    return torch.stack([position, velocity * PUSH, over - points / 100], 1).float()
