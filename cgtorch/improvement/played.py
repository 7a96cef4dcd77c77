"""Single episodes in a world with rewards, of which every step is kept to learn from."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import torch
from torch import Generator, Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.asked import NOTHING, Asked, Purse
from cgtorch.ground.environment import Lanes, asked_of, start_lanes
from cgtorch.simulation import rollout


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Steps:
    """n steps in the world.

    Attributes:
        percept: (n, D) before each step.
        control: (n, U) as it was sent.
        after: (n, D) the next percept.
        reward: (n,) float64, what the step gave.
        ended: (n,) bool, whether it ended its episode; an end by the largest number of steps does
            not count.
    """

    percept: Tensor
    control: Tensor
    after: Tensor
    reward: Tensor
    ended: Tensor

    def __len__(self) -> int:
        return len(self.reward)

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """The steps of all parts, in order."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*map(torch.cat, columns))

    def rows(self, which: Tensor) -> Self:
        """Some of the steps, by a mask (n,) or indices (m,)."""
        return type(self)(*(getattr(self, f.name)[which] for f in fields(self)))


class OneEpisode:
    """A world of one scenario that counts, keeps and breaks off what is done in it."""

    def __init__(self, world: Any, purse: Purse, phase: str, most: float, limit: float) -> None:
        """The world.

        Args:
            world: One that is `Rewarded`.
            purse: Pays for each step, as for a motion.
            phase: For what the purse pays.
            most: Steps after which the episode is broken off.
            limit: Steps after which the world ends it by itself.
        """
        self.world, self.most, self.limit = world, most, limit
        self.purse, self.phase, self.steps = purse, phase, list[Steps]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.world, name)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        able = control.isfinite().all(1) & ~self.world.over(lanes)
        if not able.all():  # nothing is carried out
            return lanes, able
        self.purse.pay(self.phase, Asked(motions=len(lanes)))
        before = asked_of(self.world)
        after, done = self.world.step(lanes, control)
        if (low := asked_of(self.world) - before) != NOTHING:  # known afterwards only
            self.purse.add(self.phase, low)
        gain = (self.world.returns(after) - self.world.returns(lanes)).double()
        ended = self.world.over(after) & (len(self.steps) + 1 < self.limit)
        parts = lanes.percept, control, after.percept, gain, ended
        self.steps.append(Steps(*(part[done].clone() for part in parts)))
        return after, done

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return self.world.over(lanes) | torch.tensor(len(self.steps) >= self.most)

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return self.world.returns(lanes)


def played(
    episode: OneEpisode, graphs: Graphs, actions: ActionSet, max_transitions: int
) -> tuple[float, Steps]:
    """What a graph returns in an episode, -inf if it did not finish, and the steps (n may be 0)."""
    episode.purse.pay(episode.phase, Asked(episodes=1))
    found = rollout(graphs, actions, episode, max_transitions=max_transitions)
    assert found.returns is not None  # noqa: S101  as the world gives rewards
    return float(found.returns[0, 0]), _all_steps(episode)


def tried_out(
    episode: OneEpisode,
    draw: Callable[[Tensor, Generator], Tensor],
    change: float,
    generator: Generator,
) -> Steps:
    """The steps of an episode of random controls, each drawn anew with chance `change`.

    `draw` maps a percept (1, D) and a generator to a control (1, U).
    """
    episode.purse.pay(episode.phase, Asked(episodes=1))
    lanes = start_lanes(episode, torch.arange(1), 0, 0)
    control = draw(lanes.percept, generator)
    while not bool(episode.over(lanes).any()):
        lanes, _ = episode.step(lanes, control)
        lanes = replace(lanes, step=lanes.step + 1)
        if float(torch.rand((), generator=generator)) < change:
            control = draw(lanes.percept, generator)
    return _all_steps(episode)


def _all_steps(episode: OneEpisode) -> Steps:
    d, u = episode.world.percept_size, episode.world.control_size
    none = torch.empty(0, dtype=torch.float64), torch.empty(0, dtype=torch.bool)
    nothing = Steps(torch.empty(0, d), torch.empty(0, u), torch.empty(0, d), *none)
    return Steps.joined([nothing, *episode.steps])
