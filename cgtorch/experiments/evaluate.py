"""Testing a skill in the world on fresh scenarios."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.improvement.trial import try_skill
from cgtorch.world import Scenarios, TabletopWorld, random_scenarios


@dataclass(frozen=True)
class Score:
    """How a skill did.

    Attributes:
        scenarios: what it was tried on.
        succeeded: (B,) bool.
        transitions: (B,) long.
    """

    scenarios: Scenarios
    succeeded: Tensor
    transitions: Tensor

    @property
    def tried(self) -> int:
        """How many scenarios."""
        return len(self.succeeded)

    @property
    def successes(self) -> int:
        """How many of them succeeded."""
        return int(self.succeeded.sum())

    @property
    def rate(self) -> float:
        """Their share, 0 if none was tried."""
        return self.successes / max(1, self.tried)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the rate (Wilson 1927)."""
        n, z = max(1, self.tried), 1.959964
        centre = (self.rate + z * z / (2 * n)) / (1 + z * z / n)
        half = z * sqrt(self.rate * (1 - self.rate) / n + z * z / (4 * n * n)) / (1 + z * z / n)
        return max(0.0, centre - half), min(1.0, centre + half)


def evaluate_skill(
    skill: Skill,
    world_of: Callable[[Scenarios], TabletopWorld],
    placement: str,
    count: int,
    seed: int,
) -> Score:
    """Try a skill on `count` fresh scenarios of a placement.

    Args:
        skill: what to try.
        world_of: makes the world.
        placement: near, left, right, far or perimeter.
        count: how many scenarios.
        seed: of the scenarios and their noise.

    Raises:
        SettingsError: unknown placement or negative count.
    """
    scenarios = random_scenarios(placement, count, Generator().manual_seed(seed))
    trial = try_skill(skill, world_of(scenarios))
    return Score(scenarios, trial.succeeded, trial.transitions)
