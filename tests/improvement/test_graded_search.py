"""The steps of a search in imagined episodes where rewards are grades."""

from dataclasses import replace
from math import inf
from typing import Any

import pytest
import torch
from imagining import DOMAIN, GOOD, search_of, told_skill
from rewarded_cart import GivenModels
from support import same, seeded
from watched import of_kind

from cgtorch.evolution import evolve
from cgtorch.graphs import Skill, compacted
from cgtorch.ground.asked import Asked, Purse
from cgtorch.improvement.events import Event, Practised, WorldAsked
from cgtorch.improvement.imagined_search import HORIZON, Search
from cgtorch.improvement.imagined_state import CHAMPIONS, State
from cgtorch.improvement.paired_race import Holder


class GradedModels(GivenModels):
    """Those of rewards that are grades."""

    graded = True


PRACTICE = 5


def practised(
    monkeypatch: pytest.MonkeyPatch, begun: State, *returns: float, late: bool = False
) -> tuple[int, State, list[Event]]:
    """How often a skill is played that returns these, one after the other, and what follows."""
    told, left = list[Event](), list(returns)
    search = search_of(kind=GradedModels, told=told)
    setup = replace(search.setup, practice=PRACTICE)
    steps, cost = begun.known.steps.rows(torch.arange(3)), Asked(motions=3, episodes=1)

    def tried(*_: Any) -> tuple[float, Any, Asked]:
        return left.pop(0), steps, cost

    monkeypatch.setattr(Search, "_tried", tried)
    monkeypatch.setattr(Purse, "late", lambda _: late)
    skill = told_skill(GOOD)
    state, offered = replace(search, setup=setup)._practised(begun, skill, seeded(1))
    assert (state.skill is skill) is offered
    count = len(returns) - len(left)
    assert len(state.known.steps) == len(begun.known.steps) + 3 * count
    assert state.steps == begun.steps + 3 * count
    return count, state, told


def test_where_rewards_are_graded_a_skill_is_played_up_to_its_first_failure(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = search_of().wanted(HORIZON)
    count, state, told = practised(monkeypatch, begun, *[good] * PRACTICE, good)
    assert (count, state.skill is not None) == (PRACTICE, True)
    (asked,), (shown,) = of_kind(told, WorldAsked), of_kind(told, Practised)
    assert (asked.asked.episodes, asked.succeeded, asked.phase) == (PRACTICE, PRACTICE, CHAMPIONS)
    assert (shown.in_a_row, shown.wanted) == (PRACTICE, PRACTICE)
    count, state, told = practised(monkeypatch, begun, good, good, good - 0.1, good)
    assert (count, state.skill) == (3, None)
    assert [each.in_a_row for each in of_kind(told, Practised)] == [2]
    assert practised(monkeypatch, begun, *[good] * (PRACTICE - 1), -inf)[0] == PRACTICE
    assert practised(monkeypatch, begun, good, late=True)[0] == 0


def test_where_rewards_are_graded_the_best_so_far_is_what_is_played_to_learn(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, told = search_of(kind=GradedModels), list[Skill]()

    def noted(_: Search, state: State, skill: Skill, *__: Any) -> tuple[State, bool]:
        told.append(skill)
        return state, False

    monkeypatch.setattr(Search, "_practised", noted)
    world = DOMAIN.world(DOMAIN.draw("any", 8, seeded(0)))
    about = world, search.setup.actions, search.setup.evolution, seeded(0)
    generation = next(evolve(*about, max_transitions=500))
    holder = Holder(told_skill(GOOD))
    for held in (holder, None):
        state = replace(begun, waited=9, inner=replace(begun.inner, holder=held))
        after, offered = search._learned(state, generation, seeded(1))
        assert (after.waited, offered) == (0, False)
    assert told[0] is holder.skill
    assert same(told[1].graph, compacted(generation.champion.graphs))
