"""The parts of a stage: what it begins with, what is met, what is chance, and what is reported."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from members import nearly
from reaching import small_knowledge, world_of
from support import seeded
from torch import Generator
from watched import (
    NONE,
    Watched,
    first_stage,
    keys,
    known,
    of_kind,
    recruited,
    stage_of,
    state_of,
    without_models,
)

from cgtorch.ground.asked import BudgetSpentError, Purse
from cgtorch.ground.statistics import wilson
from cgtorch.improvement.events import ChanceFound, Event, Practised, SkillAccepted, WorldTested
from cgtorch.improvement.improve import (
    CONFIDENCE,
    DECISIVE,
    MOST_JUDGED,
    OTHER,
    SAME,
    _begun,
    _looks,
    _on_known,
    _report_accepted,
    acted,
    improve,
    without_chance,
)
from cgtorch.improvement.state import BLAME, Candidate
from cgtorch.improvement.team import REFLECT
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import Scenarios, random_scenarios

MEMBER = nearly(0.3)
OTHERS = replace(nearly(-1.0), name="idle")
MANY = random_scenarios("near", 200, seeded(0))
_DONE = try_skill(MEMBER, world_of(MANY)).succeeded
GOOD, BAD = MANY[_DONE], MANY[~_DONE]


def drawing(drawn: list[int]) -> Any:
    """Draws scenarios that the member solves, and notes how many."""

    def draw(count: int, generator: Generator) -> Scenarios:
        drawn.append(count)
        return GOOD[100 - count : 100]

    return draw


@pytest.mark.parametrize("chance", [False, True])
def test_a_stage_begins_with_w_its_tests_m_and_looks(chance: bool) -> None:
    before = replace(known(world_of, MEMBER, GOOD[:6], BAD[:2]), chance=chance)
    drawn = list[int]()
    setup = stage_of(without_models(looks=4, core=3))
    state = _begun(setup, before, GOOD[10:13], drawing(drawn))
    assert drawn == [4]
    tests, waiting = (NONE, GOOD[10:13]) if chance else (GOOD[10:13], NONE)
    rest, percepts = state.rest
    assert len(rest) == 3
    w = [key for key in keys(GOOD[:6]) if key not in keys(rest)]
    assert keys(state.scenarios) == w + keys(tests.joined(BAD[:2], GOOD[96:100]))
    assert keys(state.waiting) == keys(waiting)
    assert torch.equal(state.percepts, first_percepts(world_of(state.scenarios)))
    assert torch.equal(percepts, first_percepts(world_of(rest)))
    kinds = torch.tensor([0] * 3 + [1] * len(tests) + [2] * 2 + [3] * 4)
    assert torch.equal(state.keep, kinds == 0)
    assert torch.equal(state.known, kinds == 0)
    assert torch.equal(state.tried, (kinds == 0) | (kinds == 2))
    assert torch.equal(state.targets, (kinds == 1) | (kinds == 2))
    shown = {0: 0 if chance else 1, 1: 0, 2: -1, 3: 0}
    assert state.shown.tolist() == [shown[kind] for kind in kinds.tolist()]
    assert state.trust.tolist() == [[1.0]] * len(kinds)
    assert state.outcomes.tolist() == [[0]] * len(kinds)
    assert state.members == (MEMBER,)
    assert state.current is not None
    assert state.current.skill is MEMBER
    assert state.repeats is not chance
    assert _begun(setup, first_stage(), NONE, drawing([])).members == ()


def test_percepts_of_the_data_stand_for_looks_that_cost_too_much() -> None:
    knowledge, drawn = small_knowledge(), list[int]()
    before = replace(first_stage(), knowledge=knowledge)
    learns = replace(without_models(looks=5), learn=lambda models, *_: models)
    seen = knowledge.dataset.percept[:5]
    robot = stage_of(replace(learns, live=True, purse=Purse()))
    poor = stage_of(replace(learns, purse=Purse({"looks": 4})))
    for setup in (robot, poor):
        looks, percepts = _looks(setup, before, NONE, drawing(drawn))
        assert torch.equal(percepts, seen)
        assert len(looks) == 5
        assert not setup.purse.total.looks
    with pytest.raises(BudgetSpentError):
        _looks(poor, before, GOOD[:1], drawing(drawn))
    with pytest.raises(BudgetSpentError):
        _looks(replace(poor, learn=None), before, NONE, drawing(drawn))


@pytest.mark.parametrize("attempts", [0, 1])
def test_where_rollouts_take_time_what_earlier_stages_missed_is_handed_on(
    attempts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    recruited(monkeypatch, replace(MEMBER, name="member"))
    before = known(world_of, OTHERS, NONE, BAD[:2])
    how = {"remembers": True, "noisy": False, "practice": 0, "attempts": attempts, "looks": 0}
    tests, watched = GOOD[:3].joined(BAD[4:5]), Watched()
    after = improve(stage_of(without_models(world_of=watched, **how)), before, tests, drawing([]))
    assert not set(keys(BAD[:2])) & set(watched.acted)
    solved, missed = (GOOD[:3], BAD[4:5]) if attempts else (NONE, NONE)
    assert keys(after.solved) == keys(solved)
    assert keys(after.missed) == keys(missed.joined(BAD[:2]))
    assert after.seen is not None
    assert torch.equal(after.seen, first_percepts(world_of(after.solved.joined(after.missed))))


def test_batches_double_up_to_a_limit_where_rollouts_take_time() -> None:
    candidate = Candidate(MEMBER)
    state = state_of(NONE, current=candidate)
    for remembers, wanted in ((True, [3, 6, 12, 12, 7]), (False, [3, 6, 12, 19])):
        drawn, told = list[int](), list[Event]()
        setup = stage_of(without_models(practice=40, remembers=remembers), told.append)
        after, done = acted(setup, state, candidate, drawing(drawn))
        assert (drawn, done, after.in_a_row) == (wanted, True, 40)
        (practised,) = of_kind(told, Practised)
        assert (practised.in_a_row, practised.wanted) == (40, 40)


def test_a_budget_that_is_spent_ends_practice_and_nothing_is_learned_from_it() -> None:
    def learn(models: Any, data: Any, generator: Generator) -> Any:
        raise AssertionError("the stage is over")

    candidate, told = Candidate(MEMBER), list[Event]()
    setup = replace(without_models(practice=9, purse=Purse({"episodes": 3})), learn=learn)
    state = state_of(NONE, current=candidate)
    after, done = acted(stage_of(setup, told.append), state, candidate, drawing([]))
    assert (done, after.in_a_row, after.keep.tolist()) == (True, 3, [True] * 3)
    (practised,) = of_kind(told, Practised)
    assert (practised.in_a_row, practised.wanted) == (3, 9)


def test_where_nothing_repeats_itself_tests_wait_and_models_learn_after_some_episodes() -> None:
    candidate, drawn = Candidate(MEMBER), list[int]()
    state = state_of(NONE, current=candidate, repeats=False, waiting=GOOD[:2])
    setup = stage_of(without_models(practice=20))
    after, done = acted(setup, state, candidate, drawing(drawn))
    assert (done, after.in_a_row, len(after.waiting)) == (False, REFLECT, 0)
    assert drawn == [1] * (REFLECT - 2)
    assert after.targets.tolist() == [True] * 2 + [False] * (REFLECT - 2)
    assert after.keep.all()
    later, done = acted(setup, replace(after, waiting=BAD[:2]), candidate, drawing(drawn))
    assert (done, later.in_a_row, len(later.waiting)) == (False, 0, 1)
    assert later.keep.tolist() == [True] * REFLECT + [False]


def test_another_candidate_begins_to_practise_anew_and_the_same_one_goes_on() -> None:
    for same, left in ((True, 2), (False, 5)):
        drawn = list[int]()
        candidate = Candidate(MEMBER)
        current = candidate if same else Candidate(OTHERS)
        state = state_of(NONE, current=current, in_a_row=3)
        after, done = acted(stage_of(without_models(practice=5)), state, candidate, drawing(drawn))
        assert (sum(drawn), after.in_a_row, done) == (left, 5, True)
        assert after.current is candidate


def test_targets_that_are_missed_leave_a_stage_unfinished() -> None:
    candidate, setup = Candidate(MEMBER), stage_of(without_models(practice=2))
    for targets, finished in ((GOOD[:2], True), (GOOD[:1].joined(BAD[:1]), False)):
        after, done = acted(setup, state_of(targets), candidate, drawing([]))
        assert (after.in_a_row, done) == (2, finished)
        assert after.tried.all()


def test_who_loses_some_of_w_is_blamed_and_does_not_act() -> None:
    members = MEMBER, OTHERS
    current, worse = Candidate(MEMBER), Candidate(OTHERS, (1,), torch.zeros(0, 36))
    scenarios = GOOD[:3].joined(BAD[:2])
    w = torch.arange(5) < 3
    state = state_of(scenarios, members, w, current=current)
    told = list[Event]()
    setup = stage_of(without_models(), told.append)
    after, lost = _on_known(setup, state, worse, [])
    assert lost
    assert after.current is current
    assert torch.equal(after.keep, w)
    assert after.trust[:, 1].tolist() == [pytest.approx(BLAME)] * 5
    assert after.outcomes[:, 1].tolist() == [-1] * 5
    (tested,) = of_kind(told, WorldTested)
    assert (tested.solved_w, tested.size_w, tested.solved_m, tested.size_m) == (0, 3, 0, 2)
    nothing = torch.zeros(5, 1, dtype=torch.long)
    alone = replace(state, members=(OTHERS,), trust=torch.ones(5, 1), outcomes=nothing)
    joined, _ = _on_known(setup, alone, Candidate(OTHERS), [])
    assert joined.members == (OTHERS, MEMBER)  # as somebody has to solve all of W
    remembered, _ = _on_known(replace(setup, remembers=True), alone, Candidate(OTHERS), [])
    assert remembered.members == (OTHERS,)


def test_the_rest_of_w_is_met_first_and_what_is_lost_of_it_joins_the_others() -> None:
    current, worse = Candidate(MEMBER), Candidate(OTHERS)
    rest = GOOD[:2], first_percepts(world_of(GOOD[:2]))
    watched = Watched()
    setup = stage_of(without_models(world_of=watched))
    state = state_of(BAD[:2], (OTHERS,), current=current, rest=rest)
    after, lost = _on_known(setup, state, worse, [])
    assert lost
    assert [each.keys for each in watched.trials] == [keys(GOOD[:2])]
    assert after.keep.tolist() == [False, False, True, True]
    assert after.members == (OTHERS, MEMBER)
    assert len(after.rest[0]) == len(after.rest[1]) == 0
    same, lost = _on_known(setup, state, current, [])
    assert (lost, len(same.rest[0])) == (False, 2)  # which is not tried again
    better, lost = _on_known(setup, state, replace(current), [])
    assert (lost, len(better.rest[0]), len(better.keep)) == (False, 2, 2)


def test_what_is_not_lost_of_the_rest_of_w_stays_there() -> None:
    current, other = Candidate(MEMBER), Candidate(replace(nearly(0.45), name="other"))
    able = try_skill(other.skill, world_of(GOOD)).succeeded
    held, lost = GOOD[able][:2], GOOD[~able][:1]
    rest = held.joined(lost)
    percepts = first_percepts(world_of(rest))
    state = state_of(BAD[:1], (OTHERS, MEMBER), current=current, rest=(rest, percepts))
    after, worse = _on_known(stage_of(without_models()), state, other, [])
    assert worse
    assert keys(after.scenarios) == keys(BAD[:1].joined(lost))
    assert torch.equal(after.percepts[1:], percepts[2:])
    assert keys(after.rest[0]) == keys(held)
    assert torch.equal(after.rest[1], percepts[:2])
    assert after.members == (OTHERS, MEMBER)  # as it is one of them


@pytest.mark.parametrize("count", [DECISIVE - 1, DECISIVE, MOST_JUDGED, MOST_JUDGED + 20])
def test_success_is_chance_if_much_less_is_solved_under_other_noise(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenarios = random_scenarios("near", count, seeded(0))
    asked = min(count, MOST_JUDGED)
    few = max(n for n in range(asked) if wilson(n, asked, CONFIDENCE)[1] < SAME)
    current, met = Candidate(MEMBER), list[Scenarios]()
    state = state_of(scenarios, (), torch.ones(count, dtype=torch.bool), current=current)
    for solved, chance in ((few, count >= DECISIVE), (few + 1, False)):

        def attempted(
            setup: Any, skill: Any, some: Scenarios, *about: Any, solved: int = solved
        ) -> Any:
            met.append(some)
            return replace(try_skill(skill, world_of(some)), succeeded=torch.arange(asked) < solved)

        monkeypatch.setattr("cgtorch.improvement.improve.attempt", attempted)
        told = list[Event]()
        after = without_chance(stage_of(without_models(), told.append), state)
        assert after.repeats is not chance
        assert after.judged is current
        assert after.other_noise == (solved, asked)
        found = of_kind(told, ChanceFound)
        assert [(each.succeeded, each.tried) for each in found] == [(solved, asked)] * chance
    other = scenarios.with_noise(OTHER)
    assert len(met[0]) == asked
    assert keys(met[0])[0] == keys(other)[0]
    assert keys(met[0])[-1] == keys(other)[-1]
    assert len(set(keys(met[0]))) == asked
    met.clear()
    for unknown in (
        (replace(without_models(), noisy=False), state),
        (without_models(), replace(state, repeats=False)),
        (without_models(), replace(state, current=None)),
        (without_models(), replace(state, keep=~state.keep)),
    ):
        assert without_chance(stage_of(unknown[0]), unknown[1]) is unknown[1]
    assert not met


@pytest.mark.parametrize("judged", [False, True])
def test_a_skill_is_reported_with_all_that_was_tried_and_the_rest_of_w(judged: bool) -> None:
    current, told = Candidate(MEMBER), list[Event]()
    scenarios, seen = GOOD[:2].joined(BAD[:2]), first_percepts(world_of(GOOD[8:9]))
    state = state_of(scenarios, (), torch.tensor([True, True, False, False]), current=current)
    state = replace(
        state,
        known=torch.tensor([True, False, False, False]),
        tried=torch.tensor([True, True, True, False]),
        targets=torch.tensor([False, False, True, True]),
        rest=(GOOD[8:9], seen),
        judged=current if judged else Candidate(MEMBER),
        other_noise=(3, 4),
    )
    setup = stage_of(without_models(), told.append)
    _report_accepted(setup, state, MEMBER, 1.5, "S0")
    (event,) = of_kind(told, SkillAccepted)
    assert keys(event.scenarios) == keys(scenarios[:3].joined(GOOD[8:9]))
    assert event.succeeded.tolist() == [True, True, False, True]
    assert event.keep.tolist() == [True, False, False, True]
    assert event.targets.tolist() == [False, False, True, False]
    assert (event.seconds, event.parent) == (1.5, "S0")
    assert event.other_noise == ((3, 4) if judged else None)
