"""When a goal holds: how often chance says so, and how often it is missed."""

from math import exp, lgamma, log
from statistics import NormalDist

import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.runs.settings import Goal
from cgtorch.training.auto import SLACK, holds, mean_holds, worth_deciding


def allowed(goal: Goal, decision: int) -> int:
    """The most failures with which the test that decides says yes; -1 if none is few enough."""
    n = goal.decisive
    yes = [f for f in range(min(n, 200)) if holds(goal, n - f, n, decision)]
    assert yes == list(range(len(yes)))
    return len(yes) - 1


def at_most(k: int, n: int, p: float) -> float:
    """The probability of k failures or fewer of n (binomial)."""
    log_terms = (
        lgamma(n + 1) - lgamma(i + 1) - lgamma(n - i + 1) + i * log(p) + (n - i) * log(1 - p)
        for i in range(k + 1)
    )
    return sum(map(exp, log_terms))


@pytest.mark.parametrize("target", [0.43, 0.7, 0.9, 0.99, 0.995])
def test_repeated_looks_stop_by_luck_in_one_run_of_forty(target: float) -> None:
    """However often a skill that is not good enough is tried; Wilson's interval is approximate."""
    goal = Goal(target=target)
    failing, n = 1 - target + SLACK * min(1 - target, 0.2), goal.decisive
    lucky = [at_most(allowed(goal, j), n, failing) for j in range(1, 31)]
    assert sum(lucky) < 0.03
    once = sum(at_most(allowed(goal, 1), n, failing) for j in range(1, 31))
    assert once > 0.06  # which is what would happen if every look were taken for the first


@pytest.mark.parametrize("target", [0.9, 0.99, 0.995])
def test_a_skill_that_is_good_enough_is_soon_recognised(target: float) -> None:
    goal = Goal(target=target)
    assert at_most(allowed(goal, 1), goal.decisive, 0.5 * (1 - target)) > 0.95
    assert at_most(allowed(goal, 3), goal.decisive, 0.5 * (1 - target)) > 0.95


def test_a_low_target_is_not_reached_by_luck() -> None:
    """Of 70 scenarios, a skill that solves 40 % solves 43 % in a third of all tests."""
    goal = Goal(target=0.43)
    assert (goal.screening, goal.decisive) == (50, 200)
    assert at_most(allowed(goal, 1), goal.decisive, 0.6) < 0.13
    assert at_most(allowed(goal, 1), goal.decisive, 0.5) > 0.8


def test_the_share_itself_must_reach_the_target() -> None:
    goal = Goal(target=0.99)
    assert goal.decisive == 4000
    assert holds(goal, 3970, 4000, 1)
    assert not holds(goal, 3960, 4000, 1)
    assert not holds(goal, 39590, 40000, 1)  # enough to be sure of 98.75 %
    assert not holds(goal, 100, 100, 1)  # of so few nothing can be said
    assert not holds(goal, 0, 0, 1)
    assert allowed(goal, 1) >= allowed(goal, 2) >= allowed(goal, 20) > 0


def test_deciding_begins_where_it_can_end_well() -> None:
    goal = Goal(target=0.99)
    assert goal.screening == 1000
    assert worth_deciding(goal, 990, 1000)
    assert not worth_deciding(goal, 989, 1000)
    assert not worth_deciding(goal, 800, 800)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("target", float("nan")),
        ("target", "0.9"),
        ("target", True),
        ("minutes", -1.0),
        ("minutes", float("inf")),
        ("rounds", 0),
        ("rounds", 2.5),
        ("rounds", True),
    ],
)
def test_impossible_goals(name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=f"{name} is {value!r}; give a"):
        Goal(**{name: value})  # type: ignore[arg-type]


def returns_above(target: float, errors: float) -> list[float]:
    """200 returns whose mean is so many standard errors above a target."""
    returns = [target + 1, target - 1] * 100
    error = (200 / 199) ** 0.5 / 200**0.5
    return [value + errors * error for value in returns]


def least_errors(decision: int) -> float:
    """How many standard errors above the target the mean has to be, by bisection."""
    low, high = 0.0, 10.0
    while high - low > 1e-6:
        middle = (low + high) / 2
        holds_there = mean_holds(returns_above(-100.0, middle), -100.0, decision)
        low, high = (low, middle) if holds_there else (middle, high)
    return high


def test_a_mean_has_to_be_surer_the_more_often_it_is_looked_at() -> None:
    """At the target itself, chance says yes in one run of three at most, however many looks."""
    errors = [least_errors(decision) for decision in range(1, 31)]
    assert errors[0] == pytest.approx(1, abs=1e-4)
    assert errors == sorted(errors)
    assert sum(1 - NormalDist().cdf(each) for each in errors) < 1 / 3


@pytest.mark.parametrize("returns", [[], [5.0]])
def test_the_mean_of_hardly_any_returns_says_nothing(returns: list[float]) -> None:
    assert not mean_holds(returns, 0.0, 1)


def test_an_unfinished_episode_has_no_return_to_hold() -> None:
    returns = [500.0] * 99
    assert mean_holds([*returns, 500.0], 400.0, 1)
    assert not mean_holds([*returns, float("-inf")], 400.0, 1)
