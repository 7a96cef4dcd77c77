"""Testing a skill in the world on fresh scenarios."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.models import Models
from cgtorch.graphs import Skill
from cgtorch.graphs.skill import a_skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.environment import Bounded
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.given import given_seed, whole_number
from cgtorch.improvement.trial import try_skill
from cgtorch.runs.settings import MOST_TRIED
from cgtorch.simulation import rollout

REPLICAS = 8  # of a scenario in the models, each with other errors
PART = 250  # scenarios that are tried at once, between two signs of progress


@dataclass(frozen=True, repr=False)
class Score:
    """The result of a skill: `succeeded` (B,) bool, and `returns` (B,) with rewards.

    `percepts` (B, D) are the first ones, and `skill` is the one that was tried, if that is known.
    """

    scenarios: Any
    percepts: Tensor
    succeeded: Tensor
    returns: Tensor | None = None
    skill: Skill | None = None

    def __repr__(self) -> str:
        """In short, as in 'Score(93 of 100)'."""
        mean = self.mean_return
        about = "" if mean is None else f", mean return {mean:.5g}"
        return f"Score({self.successes} of {self.tried}{about})"

    def of(self, rows: Tensor) -> "Score":
        """The score on some of the scenarios, given as a mask (B,)."""
        returns = None if self.returns is None else self.returns[rows]
        parts = self.scenarios[rows], self.percepts[rows], self.succeeded[rows]
        return Score(*parts, returns, self.skill)

    @property
    def tried(self) -> int:
        """Number of scenarios."""
        return len(self.succeeded)

    @property
    def successes(self) -> int:
        """Number of successes."""
        return int(self.succeeded.sum())

    @property
    def values(self) -> Tensor:
        """(B,) what counts in the mean: the returns, or successes as 0 and 1."""
        return self.succeeded.float() if self.returns is None else self.returns

    @property
    def error(self) -> float | None:
        """The standard error of the mean return; None where there is none."""
        if self.mean_return is None or self.returns is None or self.tried < 2:
            return None
        return float(self.returns.double().std()) / self.tried**0.5

    @property
    def mean_return(self) -> float | None:
        """The mean return; None without rewards, or if an episode did not finish."""
        if self.returns is None or not len(self.returns) or not self.returns.isfinite().all():
            return None
        return float(self.returns.double().mean())


def joined(scores: list[Score]) -> Score:
    """The score of several batches, at least one, of one skill."""
    first, *more = (s.scenarios for s in scores)
    returns = [s.returns for s in scores if s.returns is not None]
    return Score(
        first.joined(*more),
        torch.cat([s.percepts for s in scores]),
        torch.cat([s.succeeded for s in scores]),
        torch.cat(returns) if len(returns) == len(scores) else None,
        scores[0].skill,
    )


def try_on(skill: Skill, domain: Domain[Any], scenarios: Any) -> Score:
    """The score of a skill on scenarios; with rewards, those with the target return are solved.

    In a world that is `Bounded`, the ranks share the scenarios.
    """
    rows, world = len(scenarios), domain.world(scenarios)
    shared = isinstance(world, Bounded)
    if shared:
        world = domain.world(scenarios[ranks.share(rows)])
    trial = try_skill(skill, world)
    returns, solved = trial.returns, trial.succeeded
    if returns is not None:
        solved = returns >= domain.target_return
    percepts = trial.percepts
    if shared:
        percepts, solved = (ranks.all_gather(x, rows) for x in (percepts, solved))
        returns = None if returns is None else ranks.all_gather(returns, rows)
    return Score(scenarios, percepts, solved, returns, skill)


def evaluate_skill(
    skill: Skill,
    domain: Domain[Any],
    kind: str,
    count: int,
    seed: int,
    done: Callable[[int], object] = lambda count: None,
) -> Score:
    """Try a skill on `count` fresh scenarios of a kind, drawn with their noise from a seed.

    `done` is called with the number of further scenarios tried. SettingsError if the kind is
    unknown, the count is none of 0 to `MOST_TRIED`, or the skill reads other percepts.
    """
    scenarios = drawn(skill, domain, kind, count, seed)
    scores = []
    for begin in range(0, max(1, len(scenarios)), PART):
        scores.append(try_on(skill, domain, scenarios[begin : begin + PART]))
        done(scores[-1].tried)
    return joined(scores)


def drawn(skill: Skill, domain: Domain[Any], kind: str, count: int, seed: int) -> Any:
    """`count` fresh scenarios of a kind for a skill, drawn with their noise from a seed.

    For errors see `evaluate_skill`.
    """
    if kind not in domain.kinds:
        raise SettingsError(f"unknown scenarios {kind!r}; use one of {', '.join(domain.kinds)}")
    a_skill(skill)
    count = whole_number(count, "count", 0, MOST_TRIED)
    scenarios = domain.draw(kind, count, Generator().manual_seed(given_seed(seed)))
    check_percepts(skill, domain.world(scenarios[:1]).percept_size, kind)
    return scenarios


def robust_successes(
    score: Score, skill: Skill, knowledge: Knowledge, models: Models[Any], seed: int
) -> Score | None:
    """The score where the models predict robust success (`robust_success`).

    None if the models were learned from percepts of another length.
    """
    percepts = score.percepts
    if percepts.shape[1] != knowledge.dataset.percept.shape[1]:
        return None
    generator = Generator().manual_seed(seed)
    return score.of(robust_success(models, skill, knowledge, percepts, generator))


def check_percepts(skill: Skill, size: int, where: str) -> None:
    """SettingsError if a network in the skill, at any level, reads percepts of another length."""
    for index in skill.graph.action[0].unique().tolist():
        action = skill.actions.actions[index] if index >= 0 else None
        reads = getattr(action, "percept_size", size)
        if reads != size:
            raise SettingsError(
                f"skill {skill.name!r} reads percepts of {reads} numbers, those of "
                f"{where} have {size}; use scenarios like those it was evolved on"
            )
    for inner in skill.sub_skills.values():
        check_percepts(inner, size, where)


def robust_success(
    models: Models[Any],
    skill: Skill,
    knowledge: Knowledge,
    percepts: Tensor,
    generator: Generator,
    replicas: int = REPLICAS,
) -> Tensor:
    """(B,) bool, whether a skill succeeds from percepts (B, D) under all of several new errors."""
    return imagined_successes(models, skill, knowledge, percepts, generator, replicas).all(1)


def imagined_successes(
    models: Models[Any],
    skill: Skill,
    knowledge: Knowledge,
    percepts: Tensor,
    generator: Generator,
    replicas: int = REPLICAS,
) -> Tensor:
    """(B, R) bool, whether a skill succeeds in Γ and C from percepts (B, D), under R new errors."""
    environment = models.imagine(knowledge, percepts, replicas, generator)
    with torch.no_grad():
        runs = rollout(
            skill.graph, skill.actions, environment, max_transitions=skill.max_transitions
        )
    return runs.succeeded.view(len(percepts), replicas)
