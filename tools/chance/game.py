"""What the worlds of chance share: episodes that a seed draws, with one control and a return."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch import Domain, DomainSettings, Lanes, ScenarioBatch, World
from cgtorch.ground.counter_rng import uniform

Rule: TypeAlias = Callable[[Tensor], Tensor]
"""Maps percepts (n, D) to controls (n, 1)."""


@dataclass(frozen=True)
class Draws(ScenarioBatch):
    """Episodes by the seeds of all that chance decides."""

    seed: Tensor  # (B,) long

    def with_noise(self, copy: int) -> Self:
        """See `ScenarioBatch.with_noise`."""
        return replace(self, seed=self.seed + (copy << 32))


class Game(World):
    """A world whose state (n, S) has the number of the step last."""

    control_size = 1

    def chances(self, state: Tensor, scenario: Tensor, count: int) -> Tensor:
        """(n, count) numbers from 0 to 1 of each step, whatever was done before."""
        return uniform(self.scenarios.seed[scenario], "chances", state[:, -1].long(), count)

    @abstractmethod
    def ended(self, state: Tensor) -> Tensor:
        """(n,) bool, whether the episode is over."""

    @abstractmethod
    def gained(self, state: Tensor) -> Tensor:
        """(n,) what was gained so far."""

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return self.ended(lanes.state)

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return self.gained(lanes.state)

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`; returns are what counts."""
        return torch.zeros(len(state), dtype=torch.bool)


@dataclass(frozen=True)
class GameSettings(DomainSettings):
    """Episodes have many steps."""

    run_defaults: ClassVar[Mapping[str, Any]] = {"max_transitions": 1000}


class GameDomain(Domain[Draws]):
    """A domain of a `Game`.

    Attributes:
        table: The class of its world.
    """

    settings_type = GameSettings
    models = None
    table: ClassVar[type[World]]

    @staticmethod
    @abstractmethod
    def rules() -> dict[str, Rule]:
        """Rules that people go by, by name."""

    def draw(self, kind: str, count: int, generator: Generator) -> Draws:
        """See `Domain.draw`."""
        return Draws(torch.randint(2**32, (count,), generator=generator))

    def world(self, scenarios: Draws) -> World:
        """See `Domain.world`."""
        return self.table(scenarios)
