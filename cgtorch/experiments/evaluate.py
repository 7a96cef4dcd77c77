"""Testing a skill in the world on fresh scenarios."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Generator, Tensor

from cgtorch.actions import BranchingNN, ContinuousNN
from cgtorch.errors import SettingsError
from cgtorch.experiments.interval import wilson
from cgtorch.graphs import Skill
from cgtorch.improvement.trial import try_skill
from cgtorch.world import Scenarios, TabletopWorld, draw_of


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
        return wilson(self.successes, self.tried, 0.95)


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
        placement: near, left, right, far, perimeter, general or general-clutter.
        count: how many scenarios.
        seed: of the scenarios and their noise.

    Raises:
        SettingsError: unknown placement, negative count, or a skill for other percepts.
    """
    scenarios = draw_of(placement)(count, Generator().manual_seed(seed))
    world = world_of(scenarios)
    check_percepts(skill, world.percept_size, placement)
    trial = try_skill(skill, world)
    return Score(scenarios, trial.succeeded, trial.transitions)


def check_percepts(skill: Skill, size: int, where: str) -> None:
    """Refuse a skill whose networks, or those of a skill in it, read percepts of another length.

    Args:
        skill: what is to be tried.
        size: length of the percepts there.
        where: how the message calls that place.

    Raises:
        SettingsError: naming both lengths.
    """
    for index in skill.graph.action[0].unique().tolist():
        action = skill.actions.actions[index] if index >= 0 else None
        if isinstance(action, ContinuousNN | BranchingNN) and action.percept_size != size:
            raise SettingsError(
                f"skill {skill.name!r} reads percepts of {action.percept_size} numbers, those of "
                f"{where} have {size}; use scenarios like those it was evolved on"
            )
    for inner in skill.sub_skills.values():
        check_percepts(inner, size, where)
