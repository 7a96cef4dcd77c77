"""What is asked of a world is counted, and what no budget covers is refused."""

import time
from dataclasses import astuple
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.ground.asked import NAMES, Asked, BudgetSpentError, Purse
from cgtorch.ground.errors import CgtorchError

ASKED = st.builds(Asked, *[st.integers(0, 20)] * len(NAMES))
LIMITED = st.sampled_from([*NAMES, "actions"])
PHASE = st.sampled_from(["trials", "practice", "looks"])


@given(ASKED, ASKED)
def test_numbers_are_added_and_subtracted_one_by_one(one: Asked, other: Asked) -> None:
    pairs = list(zip(astuple(one), astuple(other), strict=True))
    assert astuple(one + other) == tuple(a + b for a, b in pairs)
    assert astuple(one - other) == tuple(a - b for a, b in pairs)
    assert one + other - other == one
    assert one + Asked() == one
    assert one.actions == one.motions + one.tests
    assert NAMES == ("motions", "tests", "looks", "episodes", "steps", "simulated")


@given(
    st.dictionaries(LIMITED, st.floats(0, 80), max_size=3),
    st.lists(st.tuples(PHASE, ASKED), max_size=12),
)
def test_what_is_refused_is_not_counted(
    limits: dict[str, float], wanted: list[tuple[str, Asked]]
) -> None:
    purse, plain = Purse(limits), dict[str, Asked]()
    refused = False
    for phase, asked in wanted:
        spent = sum(plain.values(), Asked())
        assert purse.total == spent
        after = spent + asked
        if all(not getattr(asked, n) or getattr(after, n) <= limits[n] for n in limits):
            purse.pay(phase, asked)
            plain[phase] = plain.get(phase, Asked()) + asked
        else:
            refused = True
            with pytest.raises(BudgetSpentError):
                purse.pay(phase, asked)
        assert purse.spent == plain
        assert purse.exhausted == refused
    for name, limit in limits.items():
        assert getattr(purse.total, name) <= limit


def test_a_limit_can_be_used_up_and_is_named_when_it_is() -> None:
    purse = Purse({"actions": 10, "looks": 2})
    purse.pay("trials", Asked(motions=6, tests=4, episodes=99))
    purse.pay("looks", Asked(looks=2))
    assert not purse.exhausted
    with pytest.raises(CgtorchError) as caught:
        purse.pay("trials", Asked(tests=1))
    assert str(caught.value) == "the budget of 10 actions is spent; raise it (budget, --budget)"
    with pytest.raises(BudgetSpentError, match="budget of 2 looks is spent"):
        purse.pay("trials", Asked(looks=1))
    assert purse.exhausted
    purse.pay("trials", Asked(episodes=1))  # of which there is no limit


def test_what_was_asked_before_is_counted_whatever_the_limit() -> None:
    purse = Purse({"motions": 5})
    purse.add("exploration", Asked(motions=7))
    assert purse.total == Asked(motions=7)
    assert not purse.exhausted
    purse.pay("trials", Asked(tests=1))
    with pytest.raises(BudgetSpentError):
        purse.pay("trials", Asked(motions=1))
    assert purse.spent == {"exploration": Asked(motions=7), "trials": Asked(tests=1)}
    assert Purse().total == Asked()
    assert not Purse().exhausted
    assert not Purse().settled


def test_after_the_time_nothing_is_paid_for() -> None:
    now = time.monotonic()
    assert not Purse().late(-inf)  # as there is no end
    for purse, late, after_a_while in (
        (Purse(until=now + 600), False, False), (Purse(until=now - 5), True, False),
    ):  # fmt: skip
        assert purse.late() == late
        assert purse.late(300) == after_a_while
        assert purse.late(-900)
    purse = Purse(until=now)
    with pytest.raises(BudgetSpentError, match="the time is over; give more"):
        purse.pay("trials", Asked(motions=1))
    assert purse.exhausted
    assert purse.spent == {}
