"""Γ of a Gymnasium environment with rewards: what actions count for, bounds, and given rewards."""

from collections.abc import Callable
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cgtorch.domains.gymnasium_limits import Effects, beyond, bounds_of_percepts
from cgtorch.domains.percept_limits import Limits
from cgtorch.domains.registry import NOT_FOUND, foreign
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.ground.errors import DomainError


class GymnasiumModels(RewardedModels[Any]):
    """Γ of an environment, whose numbers are those of its observations, scaled."""

    def __init__(self, domain: Any) -> None:
        """The models of a `Gymnasium`; DomainError if its rewards cannot be imported."""
        super().__init__(domain)
        self.most_steps = domain.episodes.most_steps
        self._effects = Effects.of(domain.episodes.actions)
        if spec := domain.settings.reward:
            self.reward = GivenReward(_function(spec), domain)

    def effect(self, control: Tensor) -> Tensor:
        """See `RewardedModels.effect`: of preferences only the largest one of a choice counts."""
        return self._effects.applied(super().effect(control))

    def limits(self, percepts: Tensor) -> Limits:
        """See `RewardedModels.limits`; numbers that are scaled have scaled bounds.

        Bounds that some percepts are beyond are none.
        """
        found, scaling = super().limits(percepts), self.domain.known.scaling
        low, high = bounds_of_percepts(self.domain.episodes.percepts)
        low, high = ((end - scaling.centre) / scaling.scale for end in (low, high))
        seen = percepts.double()
        below, above = beyond(low, high, seen.amin(0), seen.amax(0))
        return Limits(
            torch.where(below, -torch.inf, low), torch.where(above, torch.inf, high), found.circles
        )


class GivenReward:
    """A user's function of observations and actions as a `Reward` of percepts and controls."""

    def __init__(self, function: Callable[..., Any], domain: Any) -> None:
        """The function of the domain's observations."""
        self.function, self._domain = function, domain

    def __call__(self, before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
        """Rewards (n,) and (n,) bool ends; DomainError if the function fails or gives others."""
        known, n = self._domain.known.scaling, len(before)
        seen, then = (p * known.scale + known.centre for p in (before.double(), after.double()))
        actions = torch.from_numpy(
            np.asarray(self._domain.episodes.controls.actions(control.numpy()))
        )
        name = self._domain.settings.reward
        found = foreign(
            lambda: self.function(seen, actions, then), f"reward {name!r} fails", "correct it"
        )
        shaped = isinstance(found, tuple) and len(found) == 2
        if not shaped or any(getattr(x, "shape", None) != (n,) for x in found):
            raise DomainError(
                f"reward {name!r} returned {found!r:.80} for {n} steps; return a tensor of {n} "
                f"rewards and a tensor of {n} bools, which steps end their episodes"
            )
        return found[0].to(before), found[1].bool()


def _function(spec: str) -> Callable[..., Any]:
    """The function "package.module:function"; DomainError if there is none."""
    entry = EntryPoint("reward", spec, "cgtorch.rewards")
    found: Callable[..., Any] = foreign(entry.load, f"cannot import reward {spec!r}", NOT_FOUND)
    if not callable(found):
        raise DomainError(f"reward {spec!r} is {found!r:.80}; give a function")
    return found
