"""The goal of the automatic loop, and the tests that decide whether it is reached.

A skill is tested many times, and one of many tests would succeed by chance. So the goal is decided
on scenarios that are drawn for nothing else, and each further decision requires more confidence.
"""

from dataclasses import dataclass
from math import isfinite, sqrt
from statistics import NormalDist, fmean, stdev

from cgtorch.domains.settings import check_options, option
from cgtorch.ground.statistics import wilson

DOUBT = 0.05
"""The probability of error of all two-sided intervals of one run together."""

SLACK = 1.25
"""How often a skill may fail, as a multiple of the target's failure rate, at the bound of the
interval."""

DECISIVE, SCREENING = 40, 10
"""Expected failures of a skill at the target, in the decisive test and in the screening test."""


@dataclass(frozen=True)
class Goal:
    """What to reach and what to spend; it can change later. SettingsError for impossible values."""

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
        "With --stage auto: begin no round after this time, min. A round that has begun is "
        "finished; --attempts and --generations bound it.",
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
        """Maximum number of scenarios of the screening test, before the decisive test: 1000."""
        return round(SCREENING / (1 - self.target))

    @property
    def decisive(self) -> int:
        """Number of scenarios of the decisive test: 4000 for 99 %."""
        return round(DECISIVE / (1 - self.target))


EPISODES, DECISIVE_EPISODES = 100, 200
"""Number of episodes of the screening test and of the decisive test, in a domain with rewards."""


def mean_holds(returns: list[float], target: float, decision: int) -> bool:
    """Whether the mean of the returns, less some standard errors, is at least the target.

    It is False if an episode has no return because it did not finish. The first decision of a run
    (`decision` counts from 1) subtracts one standard error; later ones subtract more, as in
    `holds`.
    """
    if len(returns) < 2 or not all(map(isfinite, returns)):
        return False
    errors = NormalDist().inv_cdf(NormalDist().cdf(-1) * 2 / (decision * (decision + 1)))
    return fmean(returns) + errors * stdev(returns) / sqrt(len(returns)) >= target


def holds(goal: Goal, succeeded: int, tried: int, decision: int) -> bool:
    """Whether a decisive test shows that the goal is reached.

    Two conditions must hold. The share solved is at least the target, and the lower end of Wilson's
    interval allows at most `SLACK` times the failures that the target allows. For 99 %, this end is
    at least 98.75 %, which takes about 99.1 % of 4000.

    Decision number j (from 1) of a run has confidence 1 - 0.05 / (j (j + 1)), so the errors of all
    decisions sum to at most 0.05. A run whose skills are all below the bound therefore ends with
    success with a probability of at most 2.5 % (intervals are two-sided, and Wilson's are
    approximate). A goal that holds means: at least 98.75 %, with confidence 97.5 %.
    """
    low, _ = wilson(succeeded, tried, 1 - DOUBT / (decision * (decision + 1)))
    return tried > 0 and succeeded >= goal.target * tried and 1 - low <= SLACK * (1 - goal.target)


def worth_deciding(goal: Goal, succeeded: int, tried: int) -> bool:
    """Whether the screening test was good enough for a decisive test."""
    return tried >= goal.screening and succeeded >= goal.target * tried
