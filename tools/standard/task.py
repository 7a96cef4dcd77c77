"""What a standard task is: a world written in torch that every library is tried in."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch import World
from cgtorch.ground.environment import Environment, Lanes, ScenarioBatch

STEPS, RETURN, OVER = -3, -2, -1
"""The last columns of a state: steps so far, the sum of rewards, and 1 once the episode is over."""


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """Starts of episodes, each by a `seed` (B,) long from which all that is random follows."""

    seed: Tensor


def starts(count: int, generator: Generator) -> Starts:
    """So many random starts."""
    return Starts(torch.randint(2**31, (count,), generator=generator))


class TaskWorld(World):
    """A rewarded world of B starts whose states (n, S) are float64 and say everything.

    A subclass gives the physics: `begin` and `advance`. States have the columns `STEPS`, `RETURN`
    and `OVER` behind those of the physics. An episode that is over goes no further.
    """

    control_size = 1
    most_steps = 0
    solved_return = 0.0

    @abstractmethod
    def begin(self, seed: Tensor) -> Tensor:
        """(n, S - 3) the physics at starts with these seeds (n,)."""

    @abstractmethod
    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The physics (n, S - 3) after controls (n, U), rewards (n,), and (n,) bool what has ended.

        The steps (n,) long are those before this one. What ends by `most_steps` need not be told.
        """

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        physics = self.begin(self.scenarios.seed[scenario]).double()
        return torch.nn.functional.pad(physics, (0, 3))

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`."""
        step = state[:, STEPS].long()
        physics, reward, ended = self.advance(state[:, :STEPS], control.double(), step)
        ended = ended | (step >= self.most_steps - 1)
        about = torch.stack([step + 1.0, state[:, RETURN] + reward, ended.double()], 1)
        after = torch.cat([physics, about], 1)
        over = state[:, OVER:] > 0
        return torch.where(over, state, after) if over.any() else after

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`: a finished episode with the return that is wanted."""
        return (state[:, OVER] > 0) & (state[:, RETURN] >= self.solved_return)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return lanes.state[:, OVER] > 0

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return lanes.state[:, RETURN]


@dataclass(frozen=True)
class Task:
    """A task as all libraries get it.

    Attributes:
        name: on the command line.
        title: in the table.
        world: makes the world of given starts; its percepts are scaled to numbers around 1.
        inputs: numbers of a percept.
        outputs: numbers of a control; one for each discrete action, of which the largest counts.
        discrete: whether controls are preferences among actions.
        solved: the mean return of fresh episodes from which the task is solved.
        most_steps: of an episode.
        test: what a solution has to pass besides, or None; see `double_pole.Challenge`.
    """

    name: str
    title: str
    world: Callable[[Starts], Environment]
    inputs: int
    outputs: int
    discrete: bool
    solved: float
    most_steps: int
    test: Any = None
