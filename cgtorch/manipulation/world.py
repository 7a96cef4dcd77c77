"""The world of an arm: states are rows of a simulator, and controls are segments."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import one_hot

from cgtorch.domains.world import World
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Lanes, ScenarioBatch
from cgtorch.ground.fields import Field
from cgtorch.manipulation.arm import Arm
from cgtorch.manipulation.simulator import (
    CLOSE,
    CLOSER,
    CLOSEST,
    SEEN,
    SOLVED,
    STEPS,
    Floats,
    Simulator,
)

CONTROL = (
    Field("x", "m"), Field("y", "m"), Field("z", "m"), Field("gripper", low=-1, high=1),
    Field("low-level steps"), Field("speed", low=0, high=1), Field("near", "m"),
)  # fmt: skip
"""The fields of a control; see `cgtorch.manipulation.simulator`."""
GRADED = 0.45  # the largest value of a state in which the task is not solved


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """Starts of episodes: the number of the task and a seed, (B,) long each."""

    task: Tensor
    seed: Tensor


class Simulators:
    """The simulators of a domain's tasks, which are made when they are first used."""

    def __init__(self, make: Callable[[str], Simulator], tasks: Sequence[str]) -> None:
        """Those that `make` makes of names of tasks."""
        self.tasks, self._make = tuple(tasks), make
        self._made: dict[int, Simulator] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Simulators are not pickled: another process makes its own."""
        return type(self), (self._make, self.tasks)

    def __getitem__(self, task: int) -> Simulator:
        """The simulator of a task."""
        if task not in self._made:
            self._made[task] = self._make(self.tasks[task])
        return self._made[task]

    @property
    def asked(self) -> Asked:
        """Low-level steps of all of them so far."""
        made = self._made.values()
        steps = sum(each.requested for each in made)
        return Asked(steps=steps, simulated=sum(each.simulated for each in made))


class ArmWorld(World):
    """Episodes of an arm, which end with success or with their time, wherever a skill is then.

    Success is graded: a state in which the task is not solved has a value below one half, which
    grows with how close the episode came to success.
    """

    control_size = len(CONTROL)

    def __init__(
        self, scenarios: Starts, simulators: Simulators, arm: Arm, size: int, num_ids: int
    ) -> None:
        """The world of starts, whose states have `size` numbers.

        Percepts tell `num_ids` tasks apart, one number each, or 0.
        """
        super().__init__(scenarios)
        self._simulators, self._arm = simulators, arm
        self._size, self._num_ids = size, num_ids
        self._hurried = False

    def hurried(self) -> "ArmWorld":
        """See `Hurried.hurried`: here an episode is over that came no closer for some time."""
        world = copy(self)
        world._hurried = True
        return world

    @property
    def asked(self) -> Asked:
        """See `Counting.asked`."""
        return self._simulators.asked

    @property
    def percept_size(self) -> int:
        """D."""
        return len(self._arm.names)

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        return self._rows([simulator.start(seed) for simulator, seed in self._of(scenario)])

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`."""
        rows, controls = state.numpy(), control.double().numpy()
        lanes = list(zip(self._of(scenario), rows, controls, strict=True))
        after = [sim.run(row[: sim.size], seed, u) for (sim, seed), row, u in lanes]
        if self._hurried:
            after = [_hurried(row, sim) for row, ((sim, _), *_) in zip(after, lanes, strict=True)]
        return self._rows(after)

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`."""
        return state[:, SOLVED] > 0

    def over(self, lanes: Lanes) -> Tensor:
        """See `Episodic.over`."""
        return self.succeeded(lanes.state) | (lanes.state[:, STEPS] >= self._horizon)

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`; a world's value is graded here."""
        state = lanes.state
        graded = GRADED * state[:, CLOSEST].clamp(0, 1)
        return lanes, torch.where(self.succeeded(state), 1.0, graded).to(lanes.percept)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        seen = state[:, SEEN : SEEN + len(self._arm.names) - 1 - self._num_ids]
        percept = self._arm.perceived(seen, state[:, STEPS] / self._horizon)
        if not self._num_ids:
            return percept
        number = one_hot(self.scenarios.task[scenario], self._num_ids)
        return torch.cat([percept, number.to(percept)], 1)

    @property
    def _horizon(self) -> int:
        """Low-level steps of an episode of any of the tasks."""
        some = next(iter(self.scenarios.task.tolist()), 0)
        return self._simulators[some].horizon

    def _of(self, scenario: Tensor) -> list[tuple[Simulator, int]]:
        tasks, seeds = self.scenarios.task[scenario].tolist(), self.scenarios.seed[scenario]
        return [(self._simulators[t], s) for t, s in zip(tasks, seeds.tolist(), strict=True)]

    def _rows(self, rows: Sequence[Any]) -> Tensor:
        """States (n, S) from rows of any lengths."""
        state = np.zeros((len(rows), self._size))
        for i, row in enumerate(rows):
            state[i, : len(row)] = row
        return torch.from_numpy(state)


class GradedArmWorld(ArmWorld):
    """The same with returns: how close an episode is to success, once it has begun."""

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        state = lanes.state
        graded = GRADED * state[:, CLOSE].clamp(0, 1) * (state[:, STEPS] > 0)
        return torch.where(self.succeeded(state), 1.0, graded)


def _hurried(row: Floats, simulator: Simulator) -> Floats:
    """The row, in which the time is over if the episode has come no closer for some time."""
    most = simulator.patience
    if most is None or row[SOLVED] or row[STEPS] - row[CLOSER] < most:
        return row
    row = row.copy()
    row[STEPS] = simulator.horizon
    return row
