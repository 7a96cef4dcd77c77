"""Γ as a world with rewards: episodes are imagined, where rewards and their ends are known.

What a step is worth and when an episode is over are functions of percepts that are given, as in
PILCO (Deisenroth and Rasmussen, ICML 2011); what happens is what Γ has learned.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.domains.gaussian_process import GaussianProcess
from cgtorch.domains.world import World
from cgtorch.environment import Lanes, ScenarioBatch

MOST_UNSURE = 1.0
"""Standard deviation of what Γ says, in units of that of all changes, beyond which nothing is
believed."""
ABOUT = 3
"""Columns of a state behind those of the percept: steps, the return, and 1 once it is over."""

Reward: TypeAlias = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""Percepts (n, D), controls (n, U) and next percepts (n, D) to rewards (n,) and (n,) bool ends."""

Effect: TypeAlias = Callable[[Tensor], Tensor]
"""Controls (n, U) to what counts of them (n, U), such as which number is the largest."""


def as_given(control: Tensor) -> Tensor:
    """`Effect` where all of a control counts."""
    return control


@dataclass(frozen=True)
class Imagined(ScenarioBatch):
    """B starts of imagined episodes.

    Attributes:
        percept: (B, D) the first percepts.
        error: (B, D) by how many standard deviations Γ errs in all of an episode.
    """

    percept: Tensor
    error: Tensor

    @classmethod
    def drawn(cls, percept: Tensor, count: int, generator: Generator) -> Self:
        """So many starts, each somewhere between two of the percepts (b, D).

        Of few starts that are known a policy would learn by heart what to do.
        """
        one, other = torch.randint(len(percept), (2, count), generator=generator)
        share = torch.rand(count, 1, generator=generator).to(percept)
        error = torch.randn(count, percept.shape[1], generator=generator).to(percept)
        return cls(share * percept[one] + (1 - share) * percept[other], error)


class RewardedModel(World):
    """Γ as a world of which no more than its data is believed.

    An episode that comes to where Γ knows nothing is over, and each step that it would have had
    left gives `unknown`, which is the least that a step gives, and 0 at most.
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
            scenarios: the starts.
            gamma: what happens, and how sure that is.
            reward: what steps give, and which of them end an episode.
            most_steps: of an episode.
            unknown: the least that a step gives, as far as is known.
            effect: what counts of controls.
            valid: percepts (n, D) to the nearest ones that can be, where the numbers of a percept
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
        """What steps give (n,), and (n,) bool what ends by them."""
        return self.reward(before, control, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return state[:, :-ABOUT]

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`; a return alone does not tell."""
        return torch.zeros(len(state), dtype=torch.bool)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return lanes.state[:, -1] > 0

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return lanes.state[:, -2]


class CuriousModel(RewardedModel):
    """Γ as a world in which nothing counts but coming to where Γ knows little, soon.

    Each step gives its novelty, and one that is left where Γ knows nothing 1 (an exploration bonus
    by disagreement with the data, as R-max gives: Brafman and Tennenholtz, JMLR 3, 2002).
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        """See `RewardedModel`; what `unknown` is given as does not count."""
        super().__init__(*given, **named)
        self.unknown = 1.0

    def gained(
        self, before: Tensor, control: Tensor, after: Tensor, unsure: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `RewardedModel.gained`."""
        ended = super().gained(before, control, after, unsure)[1]
        return (unsure / MOST_UNSURE).clamp_max(1), ended
