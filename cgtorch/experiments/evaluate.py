"""Testing a skill in the world on fresh scenarios."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch.actions import BranchingNN, ContinuousNN
from cgtorch.errors import SettingsError
from cgtorch.experiments.interval import wilson
from cgtorch.graphs import Skill
from cgtorch.improvement.knowledge import Knowledge
from cgtorch.improvement.promise import promised
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.world import Scenarios, TabletopWorld, draw_of

PART = 250  # scenarios that are tried at once, between two signs of progress
OTHER_NOISE = 1000  # scenarios of W at most that an accepted skill meets again
FRESH_COPY = 1000  # of their noise; copies of small numbers have chosen the members


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

    def of(self, rows: Tensor) -> "Score":
        """The score on some of the scenarios, a mask (B,)."""
        return Score(
            self.scenarios[rows.nonzero()[:, 0]], self.succeeded[rows], self.transitions[rows]
        )

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
    done: Callable[[int], object] = lambda count: None,
) -> Score:
    """Try a skill on `count` fresh scenarios of a placement.

    Args:
        skill: what to try.
        world_of: makes the world.
        placement: near, left, right, far, perimeter, general or general-clutter.
        count: how many scenarios.
        seed: of the scenarios and their noise.
        done: is told of how many more scenarios it has been tried.

    Raises:
        SettingsError: unknown placement, negative count, or a skill for other percepts.
    """
    scenarios = draw_of(placement)(count, Generator().manual_seed(seed))
    check_percepts(skill, world_of(scenarios[:1]).percept_size, placement)
    trials = []
    for begin in range(0, max(1, count), PART):
        part = scenarios[begin : begin + PART]
        trials.append(try_skill(skill, world_of(part)))
        done(len(part))
    succeeded, transitions = (
        torch.cat([getattr(t, name) for t in trials]) for name in ("succeeded", "transitions")
    )
    return Score(scenarios, succeeded, transitions)


def kept_promises(
    score: Score, skill: Skill, knowledge: Knowledge, world: TabletopWorld, seed: int
) -> Score | None:
    """How a skill did in the world where it succeeds in the models.

    Args:
        score: in the world.
        skill: what was tried.
        knowledge: the models.
        world: the world of the score's scenarios.
        seed: of the errors that are imagined.

    Returns:
        The score on what the models promise (`cgtorch.improvement.promise`); None where they were
        learned from percepts of another length.
    """
    percepts = first_percepts(world)
    if percepts.shape[1] != knowledge.dataset.percept.shape[1]:
        return None
    generator = Generator().manual_seed(seed)
    return score.of(promised(skill, knowledge, percepts, world.footprint, generator))


def under_other_noise(
    skill: Skill,
    world_of: Callable[[Scenarios], TabletopWorld],
    solved: Scenarios,
    seed: int,
    most: int = OTHER_NOISE,
) -> Score:
    """How a skill does on what it solved, W, when it meets other noise than it did.

    Args:
        skill: what to try.
        world_of: makes the world.
        solved: W.
        seed: of the choice where W is larger than `most`.
        most: scenarios at most, a random choice of W.
    """
    pick = torch.randperm(len(solved), generator=Generator().manual_seed(seed))[:most]
    scenarios = solved[pick].with_noise(FRESH_COPY)
    trial = try_skill(skill, world_of(scenarios))
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
