"""Whose turn it is to be tuned, and how much, in a search for the best mean."""

from dataclasses import replace

import pytest
from lottery import ACTIONS, staking

from cgtorch.improvement.expected_state import AHEAD, SHARE, Spent, State
from cgtorch.improvement.tuning import DOUBTFUL, Tuning, begun


def tuning(toll: float = 0.0, lost: int = 0) -> Tuning:
    found = begun(staking(0.5).graph, ACTIONS, 1, toll)
    assert found is not None
    return replace(found, lost=lost)


def behind(tuned: int, lost: int = 0, toll: float = 0.0) -> bool:
    """Whether it is the turn of what has spent so much, where its rival has spent 100."""
    spent = Spent(tuned=tuned, rivals=100)
    return State(tuning=tuning(lost=lost), rivals=(tuning(toll),), spent=spent).behind


def test_what_wins_races_has_more_turns_than_its_rivals() -> None:
    assert behind(100 * AHEAD - 1)
    assert not behind(100 * AHEAD)


@pytest.mark.parametrize("about", [{"lost": DOUBTFUL}, {"toll": 0.5}], ids=["loses", "toll"])
def test_what_loses_and_what_has_a_rival_with_a_toll_has_as_many(about: dict[str, float]) -> None:
    assert behind(99, **about)  # type: ignore[arg-type]
    assert not behind(100, **about)  # type: ignore[arg-type]


def test_who_is_alone_has_the_turn() -> None:
    assert State(tuning=tuning(), spent=Spent(tuned=10**6)).behind
    assert not State(rivals=(tuning(),)).behind


def test_enough_is_tuned_by_what_generations_have_executed() -> None:
    spent = Spent(searched=10, tuned=4 * SHARE, rivals=6 * SHARE)
    assert State(spent=spent).enough
    assert not State(spent=replace(spent, rivals=6 * SHARE - 1)).enough
