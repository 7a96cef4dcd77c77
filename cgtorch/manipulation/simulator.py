"""Episodes of one task of an arm, which continue from any state.

A row describes a state: low-level steps so far, whether the task has been solved, how close it is
to that and how close it came, after how many steps it last came closer, what is seen, and the state
of the environment (`cgtorch.manipulation.mujoco_states`). A control is a segment: the hand moves to
a target, at most for a number of low-level steps.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cgtorch.manipulation.mujoco_states import MujocoStates

STEPS, SOLVED, CLOSE, CLOSEST, CLOSER, SEEN = range(6)
"""Columns of a row; what is seen begins at the last."""
X, Y, Z, GRIP, LIMIT, SPEED, NEAR = range(7)
"""Columns of a control: a target in m, -1 to open the gripper or 1 to close it, low-level steps at
most, a share of the full speed, and the distance on each axis, in m, at which the motion ends."""
STILL, PATIENCE = 0.001, 4
"""A motion ends, too, if the hand moved less than so far, in m, in so many low-level steps."""
CLEARLY = 0.005  # by which a segment has to come closer
REMEMBERED = 40_000  # segments, of about 4 kB each

Floats = NDArray[np.float64]


class Simulator(ABC):
    """The episodes of one task; a subclass says what is seen, and how the arm moves.

    Attributes:
        horizon: Low-level steps of an episode.
        seen: How many numbers are seen.
        states: The states of the environment.
        at_the_end: Whether a task has to be solved at the last step of an episode, not at any.
        patience: Low-level steps in which an episode of a search has to come closer to success, so
            that it goes on; None without a limit.
        gain: The share of full speed per metre that is left.
        simulated: Low-level steps so far.
        requested: Low-level steps so far, those that were remembered included.
        watch: Called after each low-level step while a film is made; nothing is then remembered or
            counted.
    """

    seen: int
    at_the_end: bool = False
    patience: int | None = None
    gain: float = 15.0
    states: MujocoStates

    def __init__(self, horizon: int) -> None:
        """Episodes of at most `horizon` low-level steps."""
        self.horizon = horizon
        self.simulated = self.requested = 0
        self.watch: Callable[[], object] | None = None
        self._known: dict[tuple[int, bytes, bytes], Floats] = {}

    @property
    def size(self) -> int:
        """The length of a row."""
        return SEEN + self.seen + self.states.size

    @abstractmethod
    def perceive(self, observation: Any) -> Floats:
        """What is seen (`seen`,): positions in m first, of the hand at the beginning."""

    @abstractmethod
    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool] | None:
        """One low-level step with an action: dx, dy, dz and grip, each in [-1, 1].

        Returned are the observation, how close the task is to being solved in [0, 1], and whether
        it is; None if that was not looked at, which it has to be if `last`.
        """

    @abstractmethod
    def hand(self) -> Floats:
        """The position of the hand (3,) in m."""

    @abstractmethod
    def closeness(self, observation: Any) -> float:
        """How close an observation at a start is to success, in [0, 1]."""

    @staticmethod
    def probing(number: int) -> Floats:
        """An action for `move`, such as any other, that differs from number to number."""
        return np.sin(np.arange(1, 5) * (number + 1.0))

    def show(self) -> None:
        """Put into the scene what only pictures show, such as a goal; nothing by default."""
        return

    def start(self, seed: int) -> Floats:
        """The row of a start."""
        state, observation = self.states.start(seed)
        close = self.closeness(observation)
        head = [0.0, 0.0, close, close, 0.0]
        return np.concatenate([head, self.perceive(observation), state])

    def over(self, row: Floats) -> bool:
        """Whether the episode of a row is over."""
        return bool(row[SOLVED] or row[STEPS] >= self.horizon)

    def run(self, row: Floats, seed: int, control: Floats) -> Floats:
        """The row after a control; the same row if the episode is over."""
        if self.over(row):
            return row
        if self.watch is not None:
            return self._moved(row, seed, control)
        key = seed, row.tobytes(), control.tobytes()
        after = self._known.get(key)
        if after is None:
            after = self._moved(row, seed, control)
            self.simulated += int(after[STEPS] - row[STEPS])
            if len(self._known) >= REMEMBERED:
                for old in list(self._known)[: REMEMBERED // 4]:
                    del self._known[old]
            self._known[key] = after
        self.requested += int(after[STEPS] - row[STEPS])
        return after

    def _moved(self, row: Floats, seed: int, control: Floats) -> Floats:
        self.states.write(row[SEEN + self.seen :], seed)
        limit = int(np.clip(control[LIMIT], 1, self.horizon - row[STEPS]))
        speed = np.clip(control[SPEED], 0.05, 1.0)
        done, solved, found = 0, False, None
        now, closest = row[CLOSE], row[CLOSEST]
        places = list[Floats]()
        while True:
            places.append(self.hand().copy())
            way = control[:GRIP] - places[-1]
            fast = self.gain * way
            fast *= min(1.0, speed / max(np.abs(fast).max(), 1e-9))
            done += 1
            arrived = done > 1 and np.abs(way).max() < control[NEAR]
            if control[NEAR] and done > PATIENCE:  # else it waits, or closes the gripper
                arrived |= np.abs(places[-1] - places[-1 - PATIENCE]).max() < STILL
            last = done == limit or arrived
            found = self.move(np.array([*fast, control[GRIP]]), last) or found
            if self.watch is not None:
                self.watch()
            if found is not None:
                now, solved = found[1:]
                closest = now if self.at_the_end else max(closest, now)
            if last or (solved and not self.at_the_end):
                break
        assert found is not None  # noqa: S101  the last step is looked at
        solved &= not self.at_the_end or row[STEPS] + done >= self.horizon
        steps = row[STEPS] + done
        closer = steps if closest > row[CLOSEST] + CLEARLY else row[CLOSER]
        head = [steps, float(solved), now, closest, closer]
        return np.concatenate([head, self.perceive(found[0]), self.states.read()])
