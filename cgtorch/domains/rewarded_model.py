"""Γ as a world with rewards: imagined episodes with a known reward function.

The rewards and ends of episodes are given functions of percepts, as in PILCO (Deisenroth and
Rasmussen, ICML 2011); the dynamics are those of Γ.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.domains.gaussian_process import GaussianProcess
from cgtorch.domains.world import World
from cgtorch.ground.environment import Lanes, ScenarioBatch

MOST_UNSURE = 1.0
"""The largest standard deviation of a prediction, in units of that of all changes, that is still
trusted."""
ABOUT = 3
"""Columns of a state after those of the percept: steps, the return, and 1 once it is over."""

Reward: TypeAlias = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""Maps percepts (n, D), controls (n, U) and next percepts (n, D) to rewards (n,) and (n,) bool
ends."""

Doubt: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps percepts (n, D) and controls (n, U) to how little is known of rewards (n,), 0 if all is."""

Effect: TypeAlias = Callable[[Tensor], Tensor]
"""Maps controls (n, U) to their effective values (n, U), such as which number is the largest."""


def as_given(control: Tensor) -> Tensor:
    """The `Effect` of a control that is effective as it is."""
    return control


@dataclass(frozen=True)
class Imagined(ScenarioBatch):
    """B starts of imagined episodes.

    Attributes:
        percept: (B, D) the first percepts.
        error: (B, D) the error of Γ during the whole episode, in standard deviations.
    """

    percept: Tensor
    error: Tensor

    @classmethod
    def drawn(cls, percept: Tensor, count: int, generator: Generator) -> Self:
        """`count` starts from percepts (b, D), each of which is as frequent as the others."""
        orders = -(-count // len(percept))
        some = [torch.randperm(len(percept), generator=generator) for _ in range(orders)]
        error = torch.randn(count, percept.shape[1], generator=generator).to(percept)
        return cls(percept[torch.cat(some)[:count]], error)


class RewardedModel(World):
    """Γ as a world that is trusted only near its data.

    An episode ends where Γ is too uncertain. Each remaining step then gives `unknown`, which is the
    least reward of a step, and at most 0.
    """

    scenarios: Imagined

    def __init__(
        self,
        scenarios: Imagined,
        gamma: GaussianProcess,
        reward: Reward,
        most_steps: int,
        unknown: float,
        effect: Effect = as_given,
        valid: Effect = as_given,
    ) -> None:
        """The world of these starts.

        Args:
            scenarios: The starts.
            gamma: Γ with its standard deviations.
            reward: The rewards of steps, and which of them end an episode.
            most_steps: The maximum number of steps of an episode.
            unknown: The least known reward of a step.
            effect: The effective values of controls.
            valid: Maps percepts (n, D) to the nearest possible ones, where the numbers of a percept
                depend on each other, such as a sine and a cosine.
        """
        super().__init__(scenarios)
        self.gamma, self.reward, self.most_steps = gamma, reward, most_steps
        self.unknown, self.effect, self.valid = min(unknown, 0.0), effect, valid
        self._error = scenarios.error * gamma.spread

    @property
    def control_size(self) -> int:
        """See `World.control_size`."""
        return self.gamma.control_size

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        percept = self.valid(self.scenarios.percept[scenario])
        return torch.nn.functional.pad(percept, (0, ABOUT))

    @torch.no_grad()
    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`."""
        before, (steps, total, over) = state[:, :-ABOUT], state[:, -ABOUT:].unbind(1)
        control = self.effect(control).to(before)
        after, unsure = self.gamma.predict(before, control)
        error = self._error[scenario] * unsure[:, None]
        after = self.valid(after + error)
        gain, ended = self.gained(before, control, after, unsure)
        lost, left = ~(unsure <= MOST_UNSURE), self.most_steps - steps
        gain = torch.where(lost, self.unknown * left, gain)
        done = ended | lost | (left <= 1)
        about = torch.stack([steps + 1, total + gain, done.to(steps)], 1)
        moved = torch.cat([torch.where(lost[:, None], before, after), about], 1)
        return torch.where(over[:, None] > 0, state, moved)

    def gained(
        self, before: Tensor, control: Tensor, after: Tensor, unsure: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The rewards of steps (n,), and (n,) bool, which episodes they end."""
        return self.reward(before, control, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return state[:, :-ABOUT]

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`; it is always False, as the return decides."""
        return torch.zeros(len(state), dtype=torch.bool)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return lanes.state[:, -1] > 0

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return lanes.state[:, -2]


class CuriousModel(RewardedModel):
    """Γ as a world that rewards only coming, soon, to where Γ or its rewards know little.

    Each step gives its novelty, and each step that remains where Γ knows nothing gives 1. This is
    an exploration bonus, as in R-max (Brafman and Tennenholtz, JMLR 3, 2002).
    """

    def __init__(self, *given: Any, doubt: Doubt | None = None, **named: Any) -> None:
        """See `RewardedModel`; `unknown` is not used. Rewards without `doubt` are known."""
        super().__init__(*given, **named)
        self.unknown, self.doubt = 1.0, doubt

    def gained(
        self, before: Tensor, control: Tensor, after: Tensor, unsure: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `RewardedModel.gained`."""
        ended = super().gained(before, control, after, unsure)[1]
        if self.doubt is not None:
            unsure = torch.maximum(unsure, self.doubt(before, control))
        return (unsure / MOST_UNSURE).clamp_max(1), ended
