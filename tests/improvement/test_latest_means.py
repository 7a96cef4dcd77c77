"""The latest means of a tuning decide without a race, where steps are what costs."""

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from lottery import ACTIONS, staking
from lottery_search import HELD, PLAYED, after_one, search_of, tuned
from support import same, seeded

from cgtorch.improvement.expected_state import State
from cgtorch.improvement.latest_means import better
from cgtorch.improvement.pace import BY_ROLLOUT, BY_STEP
from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.tuning import EVERY, SAMPLES, TRAIL


def test_a_mean_holds_without_a_race_if_the_latest_means_were_better() -> None:
    known, unknown = torch.full((50,), 0.2), torch.tensor([-50.0, 50.0] * 3)
    rival = tuned(staking(0.0), updates=1)
    for values, worth, seen, lost in (
        (known, 30.0, 3, 0),
        (known, 30.0, 2, 2),  # as the mean of this update is the third one
        (known, -30.0, 3, 3),
        (unknown, 30.0, 3, 0),  # though the holder may be as good
        (unknown, -30.0, 3, 3),
        (torch.full((TRAIL - 1,), 0.2), 30.0, 3, 2),
        (torch.full((TRAIL,), 0.2), 30.0, 3, 0),
        (torch.full((TRAIL,), 0.2), -30.0, 3, 3),
    ):
        holds = not lost
        holder = Holder(staking(-1.0)).met(values)
        one = tuned(staking(1.0), updates=EVERY - 1, lost=2, trail=(worth,) * seen)
        spent = replace(PLAYED, raced=10**6)
        state = after_one(State(holder, one, (rival,), spent=spent))
        assert state.tuning is not None
        assert state.holder is not None
        assert (state.holder.skill is not holder.skill) is holds
        assert state.tuning.lost == lost
        assert len(state.tuning.trail) == seen + 1
        if holds:
            assert same(state.holder.skill.graph, state.tuning.mean(ACTIONS))
            known_by = torch.tensor(state.tuning.trail)
            assert state.holder.mean == pytest.approx(float(known_by.mean()))
            assert state.holder.count == TRAIL


def test_the_latest_means_decide_even_where_a_race_can_be_paid() -> None:
    search, one = search_of(), tuned(staking(1.0), trail=(-30.0,) * TRAIL)
    for held, trail, raced in ((TRAIL, TRAIL, 0), (TRAIL - 1, TRAIL, 1), (TRAIL, TRAIL - 1, 1)):
        holder = Holder(staking(-1.0)).met(torch.full((held,), 0.2))
        about = replace(one, trail=one.trail[:trail])
        for spent, more in ((PLAYED, raced), (replace(PLAYED, raced=10**6), 0)):
            state, after, _ = search._challenged(State(holder, spent=spent), about, seeded(0))
            assert (state.spent.raced > spent.raced) == more
            assert after.lost == (0 if raced and not more else after.lost)
        assert raced or after.lost == 1


@pytest.mark.parametrize(("worth", "holds"), [(30.0, True), (-30.0, False), (0.3, False)])
def test_a_rivals_mean_holds_if_it_is_surely_better(worth: float, holds: bool) -> None:
    values = torch.tensor([0.1, 0.3] * 25) if worth == 30 else torch.tensor([-9.7, 10.1] * 25)
    holder = Holder(staking(-1.0)).met(values)  # which are 0.2 in the mean
    rival = tuned(staking(1.0), updates=EVERY - 1, lost=2, alone=True, trail=(worth,) * 3)
    other = tuned(staking(0.0), updates=EVERY)
    spent = replace(PLAYED, raced=10**6)
    state = after_one(State(holder, None, (rival, other), settled=True, spent=spent))
    assert (state.holder is holder) is not holds
    if holds:
        assert state.holder is not None
        assert state.tuning is not None
        assert same(state.holder.skill.graph, state.tuning.mean(ACTIONS))
        assert (state.tuning.lost, state.tuning.trail[:3]) == (0, rival.trail)
        assert state.rivals == (other,)
    else:
        assert state.tuning is None
        assert [each.lost for each in state.rivals] == [0, 3]


def test_means_are_tried_where_races_are_due_and_steps_are_what_costs() -> None:
    for updates, pace, tried in (
        (EVERY - 1, BY_STEP, 1),
        (EVERY - 2, BY_STEP, 0),
        (EVERY - 1, BY_ROLLOUT, 0),
    ):
        one = tuned(staking(1.0), updates=updates)
        state = after_one(State(HELD, one, (), spent=PLAYED), pace)
        assert state.tuning is not None
        assert len(state.tuning.trail) == tried
        cost = 2 * (SAMPLES + tried)  # of two scenarios
        assert state.spent.tuned == cost
    full = tuned(staking(1.0), trail=(1.0, 2.0, 3.0, 4.0))
    assert full.seen(5.0).trail == (2.0, 3.0, 4.0, 5.0)
    assert full.moved(staking(0.5).graph, ACTIONS).trail == ()  # which are of other means


def test_the_latest_means_have_to_be_better_by_the_error_of_both() -> None:
    def promoted(values: Sequence[float], *trail: float, holds: bool = False) -> bool:
        holder = Holder(staking(-1.0)).met(torch.tensor(values))
        return better(holder, tuned(staking(1.0), trail=trail), holds)

    error = math.sqrt(5 / 3) / math.sqrt(TRAIL)  # of 1, 2, 3 and 4
    for more, wanted in ((1e-3, False), (-1e-3, True)):
        assert promoted([2.5 - error + more] * 9, 1.0, 2.0, 3.0, 4.0) is wanted
        assert promoted([1.0, 2.0, 3.0, 4.0], *[2.5 + error - more] * TRAIL) is wanted
        both = math.sqrt(2) * error
        shifted = [each + both - more for each in (1.0, 2.0, 3.0, 4.0)]
        assert promoted([1.0, 2.0, 3.0, 4.0], *shifted) is wanted
    assert not promoted([1.0] * 9, *[1.0 - 1e-3] * TRAIL)
    assert not promoted([0.0, 2.0] * 9, *[1.0] * TRAIL)
    assert promoted([0.0, 2.0] * 9, *[1.0] * TRAIL, holds=True)  # as good is enough for it
    assert not promoted([0.0, 2.0] * 9, *[0.999] * TRAIL, holds=True)
    assert promoted([1e8] * 9, *[1e8 + 1] * TRAIL)
    assert not promoted([1e8] * 9, *[1e8 - 1] * TRAIL)  # the same in single precision
    assert not better(None, tuned(staking(1.0), trail=(9.0,) * TRAIL), False)
