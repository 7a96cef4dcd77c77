"""What the autonomous loop aims at, and when that holds.

A skill is tested again and again, and among many looks at chance one is lucky in the end. So what
decides are placements drawn for nothing else afterwards, and every try needs more confidence.
"""

from dataclasses import dataclass
from math import isfinite, sqrt
from statistics import NormalDist, fmean, stdev

from cgtorch.domains.settings import check_options, option
from cgtorch.ground.interval import wilson

DOUBT = 0.05
"""What all two-sided intervals of one run together leave to chance."""

SLACK = 1.25
"""How often a skill may fail as a multiple of what the target allows, with confidence."""

DECISIVE, SCREENING = 40, 10
"""Failures expected, in the test that decides and the one before, of a skill at the target."""


@dataclass(frozen=True)
class Goal:
    """What to reach and what to spend, changeable later; SettingsError if a value cannot work."""

    target: float = option(
        0.99,
        "With --stage auto: the share of fresh scenarios to solve. In a domain with rewards: the "
        "return from which an episode counts as solved, and the mean return to reach.",
        least=0.5,
        most=0.999,
        when="Raise it for a surer skill; the tests become longer.",
    )
    minutes: float = option(
        10.0,
        "With --stage auto: begin no round after this time, min.",
        least=0,
        most=1e6,
        when="Raise it for hard tasks.",
    )
    rounds: int = option(
        30,
        "With --stage auto: maximum number of rounds of a run.",
        when="Lower it to bound the work in place of the time.",
    )

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def screening(self) -> int:
        """Placements that a skill is tried on, at most, before it is worth deciding: 1000."""
        return round(SCREENING / (1 - self.target))

    @property
    def decisive(self) -> int:
        """Placements of the test that decides: 4000 for 99 %."""
        return round(DECISIVE / (1 - self.target))


EPISODES, DECISIVE_EPISODES = 100, 200
"""Episodes of the test before the one that decides, and of that, where a domain gives rewards."""


def mean_holds(returns: list[float], target: float, decision: int) -> bool:
    """Whether the mean of returns, less one standard error, is at least the target.

    It is not where an episode has no return, as it was not finished.

    Later decisions of a run (`decision` counts from 1) ask for more errors, as in `holds`.
    """
    if len(returns) < 2 or not all(map(isfinite, returns)):
        return False
    errors = NormalDist().inv_cdf(NormalDist().cdf(-1) * 2 / (decision * (decision + 1)))
    return fmean(returns) + errors * stdev(returns) / sqrt(len(returns)) >= target


def holds(goal: Goal, succeeded: int, tried: int, decision: int) -> bool:
    """Whether a decisive test says that the goal is reached.

    It does if the share solved is at least the target and, besides, the lower end of Wilson's
    interval allows at most `SLACK` times the failures that the target does: for 99 %, it is at
    least 98.75 %, which takes about 99.1 % of 4000. Of the run's decisions, number j (from 1) has
    confidence 1 - 0.05 / (j (j + 1)). What these leave to chance sums to 0.05 however many there
    are, so a run whose skills are all worse than that bound ends as if one had reached the goal
    with a probability of 2.5 % at most (intervals are two-sided, and Wilson's are approximate).
    A goal that holds says therefore: at least 98.75 %, with confidence 97.5 %, no more.
    """
    low, _ = wilson(succeeded, tried, 1 - DOUBT / (decision * (decision + 1)))
    return tried > 0 and succeeded >= goal.target * tried and 1 - low <= SLACK * (1 - goal.target)


def worth_deciding(goal: Goal, succeeded: int, tried: int) -> bool:
    """Whether a skill did so well in the test before that the one that decides is worth it."""
    return tried >= goal.screening and succeeded >= goal.target * tried
