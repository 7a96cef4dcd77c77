"""Why a skill fails: each kind of failure once, with its way through the graph and its causes.

Failures are of one kind if the skill ends in the same way, at the same node, with the same outcome
of its last action.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.domain import Domain, rewarded
from cgtorch.domains.failures import Cause, Failure, Failures, Searched, Split, Tried
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.way import Judge, node_of, way_of
from cgtorch.graphs import Skill
from cgtorch.ground.environment import Live
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.fields import Field
from cgtorch.simulation.endings import Ending, endings
from cgtorch.training.advice import advice_about, blame_of
from cgtorch.training.causes import causes_of
from cgtorch.training.evaluate import Score

MOST = 200  # failures that are looked at
FEWEST, CAUSED = 4, 24  # failures of a kind whose causes are looked for
ACTS = 2000  # of all these together, more or less, as each of them takes several trials
TOLD_APART = 0.75  # balanced accuracy of a threshold that tells failures from successes
DOUBT = 0.05  # probability that chance alone would tell them apart so well


@dataclass(frozen=True)
class Background:
    """What is known of the run of a skill, besides its domain.

    Attributes:
        knowledge: Γ and C, in which the skill was evolved; None if they are not at hand.
        modelled: Whether the skill was evolved in models.
        searched: What the log says of the search; None if it is not known.
    """

    knowledge: Knowledge | None = None
    modelled: bool = False
    searched: Searched | None = None


NOTHING = Background()


def failures_of(
    skill: Skill,
    domain: Domain[Any],
    score: Score,
    known: Background = NOTHING,
    tried: tuple[Tried, ...] = (),
) -> Failures:
    """Why a skill fails in a score, from up to `MOST` failures.

    `tried` says of what kinds its scenarios are. Those that succeed when they are met again are
    left out. SettingsError if the world is a robot, which cannot be put back.
    """
    rows = (~score.succeeded).nonzero()[:MOST, 0]
    tried = tried or (Tried("", score.tried, score.successes),)
    world = domain.world(score.scenarios[rows])
    if isinstance(world, Live):
        raise SettingsError(
            "a robot cannot be put back to where it failed; find failures in a simulated world"
        )
    ended = endings(skill, world)
    aim = domain.target_return if rewarded(domain) else None
    solved = [_solves(one, aim) for one in ended]
    left = [i for i, good in enumerate(solved) if not good]
    failed = _Failed(score.of(rows), ended, rows.tolist()).of(left)
    kinds = _kinds(skill, domain, failed, known)
    found = Failures(
        skill.name, tried, len(rows), sum(solved), kinds, split_of(score, domain.percept)
    )
    advice = advice_about(found, domain, score, known.searched)
    blame = blame_of(found, known.modelled)
    if any(each.cause == "goal" for each in advice):
        blame = "Neither: the target is reached."
    return replace(found, blame=blame, advice=advice)


def _solves(ending: Ending, aim: float | None) -> bool:
    """Whether an ending is a success: with rewards, whether the return reaches the target."""
    return ending.end == "success" if aim is None else (ending.returned or 0) >= aim


@dataclass(frozen=True)
class _Failed:
    """Failures of one skill: their score, how each has ended, and the numbers of the scenarios."""

    score: Score
    ended: list[Ending]
    numbers: list[int]

    def of(self, rows: list[int]) -> "_Failed":
        """Some of them."""
        score = self.score.of(torch.tensor(rows, dtype=torch.long))
        return _Failed(score, [self.ended[i] for i in rows], [self.numbers[i] for i in rows])


def _kinds(
    skill: Skill, domain: Domain[Any], failed: _Failed, known: Background
) -> tuple[Failure, ...]:
    """The kinds of these failures, the most frequent first."""
    names = [(one.end, f"{node_of(one.step)} → {one.step.outcome}") for one in failed.ended]
    judge = Judge(known.knowledge, domain.percept)
    rows = {name: [i for i, n in enumerate(names) if n == name] for name in Counter(names)}
    order = sorted(rows, key=lambda name: -len(rows[name]))
    return tuple(_kind(name, skill, domain, failed.of(rows[name]), known, judge) for name in order)


def _kind(
    name: tuple[str, str],
    skill: Skill,
    domain: Domain[Any],
    failed: _Failed,
    known: Background,
    judge: Judge,
) -> Failure:
    """One kind of failure, all of whose failures are given."""
    most = max(FEWEST, ACTS // max(one.acts for one in failed.ended))
    few = failed.of([*range(min(CAUSED, most, len(failed.ended)))])
    about = few.score.scenarios, few.score.percepts, few.ended, known.knowledge
    causes = causes_of(skill, domain, *about, "open" if known.modelled else "world")
    by_cause = tuple(
        Cause(each, tuple(n for n, one in zip(few.numbers, causes, strict=True) if one == each))
        for each, _ in Counter(causes).most_common()
    )
    example = causes.index(by_cause[0].name)
    order = [example, *(i for i in range(len(failed.ended)) if i != example)]
    returns = tuple(r for i in order if (r := failed.ended[i].returned) is not None)
    way = way_of(skill, domain.world(failed.score.scenarios[example : example + 1]), judge)
    return Failure(*name, tuple(failed.numbers[i] for i in order), by_cause, returns, way)


def split_of(score: Score, percept: Sequence[Field]) -> Split | None:
    """The number of the first percepts that best tells failures from successes, if one does.

    It has to do so better than chance would by the bound of the Kolmogorov-Smirnov test of two
    samples, for all numbers together (Bonferroni).
    """
    good, seen = score.succeeded, score.percepts
    failures, successes = score.tried - score.successes, score.successes
    if not failures or not successes:
        return None
    found = [_threshold(values, good) for values in seen.unbind(1)]
    d = max(range(len(found)), key=lambda i: found[i][0])
    accuracy, threshold, above = found[d]
    rows = failures * successes / score.tried
    chance = len(found) * 2 * exp(-2 * (2 * accuracy - 1) ** 2 * rows)
    if accuracy < TOLD_APART or chance > DOUBT:
        return None
    beyond = (seen[:, d] > threshold) == above
    known = len(percept) == seen.shape[1]
    name, unit = (percept[d].name, percept[d].unit) if known else (str(d), "")
    return Split(
        name, unit, threshold, above,
        (int((beyond & ~good).sum()), int((~good).sum())),
        (int((beyond & good).sum()), int(good.sum())),
    )  # fmt: skip


def _threshold(values: Tensor, good: Tensor) -> tuple[float, float, bool]:
    """The best threshold of values (B,): balanced accuracy, place, whether failures exceed it."""
    order = values.argsort(stable=True)
    sorted_, failed = values[order], (~good[order]).double()
    below = failed.cumsum(0)[:-1] / failed.sum()  # share of failures up to here
    solved = (1 - failed).cumsum(0)[:-1] / (1 - failed).sum()
    between = sorted_[1:] > sorted_[:-1]
    gain = torch.where(between, below - solved, 0.0)
    at = int(gain.abs().argmax())
    middle = float((sorted_[at] + sorted_[at + 1]) / 2)
    return 0.5 + float(gain[at].abs()) / 2, middle, bool(gain[at] < 0)
