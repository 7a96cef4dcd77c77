"""Testing a skill in the world on fresh scenarios."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.actions import BranchingNN, ContinuousNN
from cgtorch.domains.domain import Domain
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.robust_success import robust_success
from cgtorch.graphs import Skill
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.interval import wilson
from cgtorch.improvement.trial import first_percepts, run_skill

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
        returns: (B,) of its episodes; None where the world gives no rewards.
    """

    scenarios: Any
    succeeded: Tensor
    transitions: Tensor
    returns: Tensor | None = None

    def of(self, rows: Tensor) -> "Score":
        """The score on some of the scenarios, a mask (B,)."""
        returns = None if self.returns is None else self.returns[rows]
        some = self.scenarios[rows.nonzero()[:, 0]]
        return Score(some, self.succeeded[rows], self.transitions[rows], returns)

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

    @property
    def mean_return(self) -> float | None:
        """The mean of the returns; None if there are none, or an episode was not finished."""
        if self.returns is None or not len(self.returns) or not self.returns.isfinite().all():
            return None
        return float(self.returns.double().mean())


def joined(scores: list[Score]) -> Score:
    """The scores of several batches, at least one."""
    first, *more = (s.scenarios for s in scores)
    returns = [s.returns for s in scores if s.returns is not None]
    return Score(
        first.joined(*more),
        torch.cat([s.succeeded for s in scores]),
        torch.cat([s.transitions for s in scores]),
        torch.cat(returns) if len(returns) == len(scores) else None,
    )


def try_on(skill: Skill, domain: Domain[Any], scenarios: Any) -> Score:
    """How a skill does on scenarios."""
    trial = run_skill(skill, domain.world(scenarios))
    return Score(scenarios, trial.succeeded, trial.transitions, trial.returns)


def evaluate_skill(
    skill: Skill,
    domain: Domain[Any],
    kind: str,
    count: int,
    seed: int,
    done: Callable[[int], object] = lambda count: None,
) -> Score:
    """Try a skill on `count` fresh scenarios of a kind.

    Args:
        skill: what to try.
        domain: what it is for.
        kind: one of the domain's.
        count: how many scenarios.
        seed: of the scenarios and their noise.
        done: is told of how many more scenarios it has been tried.

    Raises:
        SettingsError: unknown kind, negative count, or a skill for other percepts.
    """
    check_kind(domain, kind)
    if count < 0:
        raise SettingsError(f"count is {count}; give 0 or more scenarios")
    scenarios = domain.draw(kind, count, Generator().manual_seed(seed))
    check_percepts(skill, domain.world(scenarios[:1]).percept_size, kind)
    scores = []
    for begin in range(0, max(1, count), PART):
        scores.append(try_on(skill, domain, scenarios[begin : begin + PART]))
        done(scores[-1].tried)
    return joined(scores)


def check_kind(domain: Domain[Any], kind: str) -> None:
    """SettingsError if a domain has no scenarios of a kind."""
    if kind not in domain.kinds:
        raise SettingsError(f"unknown scenarios {kind!r}; use one of {', '.join(domain.kinds)}")


def promise_kept(
    score: Score, skill: Skill, knowledge: Knowledge, domain: Domain[Any], seed: int
) -> Score | None:
    """How a skill did in the world where it succeeds in the models.

    Args:
        score: in the world.
        skill: what was tried.
        knowledge: the models.
        domain: what they are of.
        seed: of the errors that are imagined.

    Returns:
        The score where the models say so under all sampled errors
        (`cgtorch.domains.robust_success`); None where they were learned from percepts of another
        length.
    """
    percepts = first_percepts(domain.world(score.scenarios))
    if percepts.shape[1] != knowledge.dataset.percept.shape[1]:
        return None
    generator = Generator().manual_seed(seed)
    return score.of(robust_success(domain, skill, knowledge, percepts, generator))


def under_other_noise(
    skill: Skill, domain: Domain[Any], solved: Any, seed: int, most: int = OTHER_NOISE
) -> Score:
    """How a skill does on what it solved, W, when it meets other noise than it did.

    Args:
        skill: what to try.
        domain: what it is for.
        solved: W.
        seed: of the choice where W is larger than `most`.
        most: scenarios at most, a random choice of W.
    """
    pick = torch.randperm(len(solved), generator=Generator().manual_seed(seed))[:most]
    return try_on(skill, domain, solved[pick].with_noise(FRESH_COPY))


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
