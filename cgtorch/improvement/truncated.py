"""A world whose episodes are truncated at a horizon, and that remembers early returns."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import torch
from torch import Tensor

from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Bounded, Environment, Lanes, Rewarded, asked_of, seeds_of


class RewardedWorld(Environment, Rewarded, Protocol):
    """An environment with rewards."""


class Truncated:
    """A `Rewarded` environment whose episodes are over after `horizon` steps at the latest.

    A state is that of the world, then the number of steps, and for each of H `marks`, which are
    numbers of steps, the return up to there. All other attributes are the world's.
    """

    def __init__(self, world: RewardedWorld, horizon: float, marks: Sequence[int]) -> None:
        """The same scenarios as in a world."""
        self._world, self._horizon, self._marks = world, horizon, torch.tensor(marks)
        self._added = 1 + len(marks)

    def __getattr__(self, name: str) -> Any:
        """What is special to the world, of which actions of a user's own may know."""
        return getattr(self.__dict__["_world"], name)

    @property
    def num_scenarios(self) -> int:
        """B."""
        return self._world.num_scenarios

    @property
    def percept_size(self) -> int:
        """D."""
        return self._world.percept_size

    @property
    def control_size(self) -> int:
        """U."""
        return self._world.control_size

    @property
    def seeds(self) -> Tensor:
        """See `Seeded.seeds`."""
        return seeds_of(self._world, torch.arange(self.num_scenarios))

    @property
    def asked(self) -> Asked:
        """See `Counting.asked`."""
        return asked_of(self._world)

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        state, percept = self._world.start(scenario)
        return torch.cat([state, state.new_zeros(len(state), self._added)], 1), percept

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        after, done = self._world.step(self._inner(lanes), control)
        added = self.added(lanes.state)
        steps = added[:, :1] + done[:, None]
        gained = self._world.returns(after)[:, None].to(added)
        early = torch.where(steps <= self._marks, gained, added[:, 1:])
        return self._outer(after, torch.cat([steps, early], 1)), done

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return self._outer(self._world.observe(self._inner(lanes)), self.added(lanes.state))

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        after, chance = self._world.success(self._inner(lanes))
        return self._outer(after, self.added(lanes.state)), chance

    def over(self, lanes: Lanes) -> Tensor:
        """See `Episodic.over`."""
        late = lanes.state[:, -self._added] >= self._horizon
        return self._world.over(self._inner(lanes)) | late

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return self._world.returns(self._inner(lanes))

    def added(self, state: Tensor) -> Tensor:
        """(..., 1 + H) what was added to states: the number of steps, and early returns."""
        return state[..., -self._added :]

    def _inner(self, lanes: Lanes) -> Lanes:
        return replace(lanes, state=lanes.state[:, : -self._added])

    def _outer(self, lanes: Lanes, added: Tensor) -> Lanes:
        return replace(lanes, state=torch.cat([lanes.state, added.to(lanes.state)], 1))


class BoundedTruncated(Truncated):
    """One of a world that is `Bounded`."""

    @property
    def most_lanes(self) -> int:
        """See `Bounded.most_lanes`."""
        return int(self._world.most_lanes)  # type: ignore[attr-defined]  # as it is bounded


def truncated(world: RewardedWorld, horizon: float, marks: Sequence[int] = ()) -> Truncated:
    """A world with episodes of at most `horizon` steps, that remembers returns up to `marks`."""
    kind = BoundedTruncated if isinstance(world, Bounded) else Truncated
    return kind(world, horizon, marks)
