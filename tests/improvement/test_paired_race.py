"""A holder falls only to a skill that is better on fresh scenarios, whatever luck says."""

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest
import scipy.stats
import torch
from lottery import ACTIONS, Lottery, PaidLottery, alone, idle, staking, tickets
from support import seeded
from torch import Generator, Tensor

from cgtorch.graphs import ActionSet, BranchingNN, Skill, resized
from cgtorch.improvement import paired_race as paired
from cgtorch.improvement.pace import BY_ROLLOUT, BY_STEP
from cgtorch.improvement.paired_race import (
    AT_LAST,
    FIRST,
    HOPELESS,
    MANY,
    SURE,
    Fresh,
    Holder,
    paired_race,
    student,
    what_counts,
)
from cgtorch.improvement.split import split

BEST, GOOD, BAD = staking(1.0), staking(0.9), staking(0.0, 1.0)
"""Skills that win 90, 87.5 and 40 % of their tickets."""


def fresh(paid: bool = False) -> Fresh:
    def world(count: int, generator: Generator) -> Lottery:
        return (PaidLottery if paid else Lottery)(tickets(count, generator))

    return Fresh(world, max_transitions=3)


def test_values_are_successes_or_returns_on_scenarios_that_all_skills_meet() -> None:
    place = fresh()
    won = place.of_skills([BEST, BAD, BEST], 20_000, seeded(0))
    assert won.mean(1).tolist() == pytest.approx([0.9, 0.4, 0.9], abs=0.02)
    assert torch.equal(won[0], won[2])
    assert place.episodes == 60_000
    assert place.executed == 60_000
    paid = fresh(paid=True).of_skills([BEST, BAD], 20_000, seeded(0))
    assert torch.equal(paid, 2 * won[:2])
    other = replace(BEST, actions=ACTIONS.extended(["Branch"], [BranchingNN(2)]))
    assert torch.equal(fresh().of_skills([other, BAD, BEST], 20_000, seeded(0)), won)
    backwards = ActionSet(ACTIONS.names[::-1], ACTIONS.actions[::-1])
    reverse = replace(BEST, actions=backwards, graph=alone(1, [1.0, 0.0]))
    assert torch.equal(fresh().of_skills([reverse, BAD, BEST], 20_000, seeded(0)), won)


def test_skills_have_any_number_of_nodes() -> None:
    actions = ACTIONS.extended(["Branch"], [BranchingNN(2)])
    large = split(BEST.graph, actions)  # of three nodes, which do what the one did
    assert large is not None
    sizes = large.edges.shape[2], large.parameters.shape[2]
    small = resized(BEST.graph, 1, *sizes)
    both = (replace(BEST, actions=actions, graph=graph) for graph in (large, small))
    one, other = fresh().of_skills(list(both), 1000, seeded(0))
    assert torch.equal(one, other)
    assert 0 < one.mean() < 1


class Lazy(Fresh):
    """Skills of this name do not finish their first episode."""

    def of_skills(self, skills: Sequence[Skill], count: int, generator: Generator) -> Tensor:
        values = super().of_skills(skills, count, generator)
        values[[each.name == "lazy" for each in skills], 0] = -math.inf
        return values


def test_whoever_does_not_finish_an_episode_loses_at_the_first_look() -> None:
    lazy, place = replace(BEST, name="lazy"), Lazy(fresh().world, 3)
    assert paired_race(place, Holder(BAD), lazy, 1000, seeded(0)) == Holder(BAD)
    assert place.episodes == 2 * FIRST
    assert paired_race(place, Holder(lazy), BAD, 1000, seeded(0)) == Holder(BAD)
    assert place.episodes == 4 * FIRST


def test_a_mean_and_its_error_are_those_of_all_values() -> None:
    values = torch.tensor([1.0, 0.0, 5.0, 2.0, 2.5])
    holder = Holder(BEST).met(values[:2]).met(values[2:])
    assert holder.skill is BEST
    assert holder.count == 5
    assert holder.mean == pytest.approx(float(values.mean()))
    assert holder.error == pytest.approx(float(values.std()) / 5**0.5)
    assert (Holder(BEST).mean, Holder(BEST).error) == (-math.inf, math.inf)
    assert Holder(BEST).met(values[:1]).error == math.inf
    assert holder.met(torch.tensor([-math.inf])).mean == -math.inf
    assert holder.met(torch.tensor([-math.inf])).error == math.inf


def test_the_first_look_is_larger_where_lanes_are_cheap() -> None:
    for pace in (BY_STEP, BY_ROLLOUT):
        place = replace(fresh(), pace=pace)
        paired_race(place, Holder(BEST), BAD, 0, seeded(0))
        assert place.episodes in {2 * FIRST * pace.at_once, 4 * FIRST * pace.at_once}


def winners(holder: Skill, challenger: Skill, longest: int, races: int = 60) -> int:
    """How many races of so many pairs a challenger wins; an episode is one action."""
    places = [fresh() for _ in range(races)]
    found = [
        paired_race(place, Holder(holder), challenger, 2 * longest, seeded(number))
        for number, place in enumerate(places)
    ]
    for place, winner in zip(places, found, strict=True):
        assert place.episodes <= 2 * max(longest, 2 * FIRST)
        # The holder stays more often where it was lucky, so these values do not count.
        assert winner == Holder(winner.skill)
    return sum(winner.skill is challenger for winner in found)


def test_the_better_one_wins_nearly_always_where_there_are_enough_scenarios() -> None:
    assert winners(BAD, BEST, 512) == 60
    assert winners(BEST, BAD, 512) == 0
    assert winners(GOOD, BEST, 20_000, races=20) >= 16


def test_an_equal_or_slightly_worse_one_seldom_wins() -> None:
    """With 5 % after the last pair and less before."""
    assert winners(BEST, staking(1.0), 2048) == 0  # which does the same
    assert winners(BEST, GOOD, 2048) <= 2
    assert winners(staking(1.0, 0.1), staking(1.0, -0.1), 2048) <= 6  # which are equal


def test_the_hopeless_end_a_race_early() -> None:
    place = fresh()
    winner = paired_race(place, Holder(BEST), BAD, 10**6, seeded(0))
    assert winner.skill is BEST
    assert place.episodes <= 2 * 8 * FIRST


def test_who_does_not_finish_an_episode_loses() -> None:
    assert paired_race(fresh(paid=True), Holder(BAD), idle(), 10**4, seeded(0)).skill is BAD
    assert paired_race(fresh(paid=True), Holder(idle()), BAD, 10**4, seeded(0)).skill is BAD


def test_few_pairs_have_to_differ_more() -> None:
    """Quantiles of Student's t distribution as tables have them."""
    for freedom, wanted in ((7, 4.53), (15, 3.59), (31, 3.26), (10**6, 3.0)):
        assert student(3.0, freedom) == pytest.approx(wanted, abs=0.05)
    assert student(1.6449, 9) == pytest.approx(1.833, abs=0.001)
    for deviations in (1.0, 2.0, 3.0):
        exact = scipy.stats.t.ppf(scipy.stats.norm.cdf(deviations), 30)
        assert student(deviations, 30) == pytest.approx(exact, abs=5e-5)


def test_what_is_played_is_counted_and_successes_or_returns_count() -> None:
    graphs = BEST.graph[torch.zeros(2, dtype=torch.long)]
    for paid in (False, True):
        place = fresh(paid)
        runs = place.runs(graphs, BEST.actions, place.world(50, seeded(0)))
        assert (place.episodes, place.executed) == (100, 100)
        values = what_counts(runs)
        assert values.shape == (2, 50)
        assert set(values.unique().tolist()) == ({0.0, 2.0} if paid else {0.0, 1.0})


def test_a_clear_difference_is_decided_after_few_pairs() -> None:
    place = fresh(paid=True)
    assert paired_race(place, Holder(BAD), BEST, 16 * FIRST, seeded(3)).skill is BEST
    assert place.episodes < 2 * 8 * FIRST


def test_a_race_has_as_many_pairs_as_its_budget_pays_and_two_looks_at_least() -> None:
    for budget, pairs in ((200, 100), (0, 2 * FIRST), (2 * 2 * FIRST + 2, 2 * FIRST + 1)):
        place = replace(fresh(), executed=50)
        assert paired_race(place, Holder(BEST), staking(1.0), budget, seeded(0)).skill is BEST
        assert place.episodes == 2 * pairs


class Given(Fresh):
    """The challenger gains a mean, more and less by 1 in turns; episodes cost an action."""

    gain = 0.0

    def of_skills(self, skills: Sequence[Skill], count: int, generator: Generator) -> torch.Tensor:
        self.executed += 2 * count
        others = self.gain + torch.arange(count) % 2 * 2 - 1
        return torch.stack([torch.zeros(count), others])


def raced(errors: float, at: int, pairs: int) -> tuple[bool, int]:
    """Whether a challenger wins that gains so many standard errors at a look, and the pairs."""
    place = Given(fresh().world, max_transitions=3)
    place.gain = errors / (at - 1) ** 0.5  # as the deviation of n is that of n / (n - 1)
    winner = paired_race(place, Holder(BAD), BEST, 2 * pairs, seeded(0))
    return winner.skill is BEST, place.executed // 2


def test_what_has_to_be_gained_depends_on_the_look() -> None:
    second = 2 * FIRST
    assert raced(1.01 * student(SURE, second - 1), second, 999) == (True, second)
    assert raced(0.99 * student(SURE, second - 1), second, second) == (False, second)
    assert raced(-1.01 * HOPELESS, second, 999) == (False, second)
    assert raced(-0.99 * HOPELESS, second, second + 4) == (False, second + 4)
    assert raced(-1.01 * student(SURE, FIRST - 1), FIRST, 999) == (False, FIRST)
    assert raced(-0.99 * student(SURE, FIRST - 1), FIRST, 999) == (False, second)
    for pairs, enough in ((MANY, AT_LAST), (MANY - 2, SURE)):
        needed = student(enough, pairs - 1)
        assert raced(1.01 * needed, pairs, pairs) == (True, pairs)
        assert raced(0.99 * needed, pairs, pairs) == (False, pairs)


def test_many_scenarios_are_played_in_several_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paired, "MOST_AT_ONCE", 8)
    place = fresh()
    assert place.of_skills([BEST, BAD], 20, seeded(0)).shape == (2, 20)
    assert place.episodes == 40


def test_the_first_look_decides_a_clear_loss_and_never_a_gain() -> None:
    def played(holder: Skill, challenger: Skill) -> list[int]:
        places = [fresh() for _ in range(60)]
        for number, place in enumerate(places):
            paired_race(place, Holder(holder), challenger, 10**4, seeded(number))
        return [place.episodes for place in places]

    assert min(played(BEST, BAD)) == 2 * FIRST
    # Of 60 times four pairs, some are all won by the better one.
    assert min(played(BAD, BEST)) > 2 * FIRST
