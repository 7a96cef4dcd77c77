"""When a stage ends: after enough fresh scenarios in a row, or once nothing more is solved."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from members import nearly
from reaching import world_of
from support import seeded
from torch import Generator
from watched import (
    NONE,
    Watched,
    along,
    first_stage,
    improved,
    keys,
    of_kind,
    recruited,
    state_of,
    without_models,
)

from cgtorch.improvement.events import Practised, SkillAccepted, WorldAsked
from cgtorch.improvement.improve import BATCH, DECISIVE, FIRST, IDLE, LONG, _wanted
from cgtorch.improvement.trial import try_skill
from cgtorch.tabletop.world import Scenarios, random_scenarios

MEMBER = nearly(0.3)
MANY = random_scenarios("near", 200, seeded(0))
_DONE = try_skill(MEMBER, world_of(MANY)).succeeded
GOOD, BAD = MANY[_DONE], MANY[~_DONE]
LOOKS = 4


def drawing(bad: set[int], drawn: list[int]) -> Callable[[int, Generator], Scenarios]:
    """Draws scenarios that the member solves, but for some of those to practise on."""

    def draw(count: int, generator: Generator) -> Scenarios:
        begin, number = sum(drawn[1:]), len(drawn)
        drawn.append(count)
        rows = torch.randint(len(GOOD), (count,), generator=generator)
        found = GOOD[rows]
        odd = torch.tensor([number > 0 and begin + i in bad for i in range(count)])
        placed = torch.where(odd[:, None], BAD.object[:1], found.object)
        pose = torch.where(odd[:, None], BAD.pose[:1], found.pose)
        seed = torch.where(odd, BAD.seed[:1], found.seed)
        return replace(found, pose=pose, object=placed, seed=seed)

    return draw


@settings(max_examples=12)
@given(st.integers(0, 70), st.sets(st.integers(0, 120), max_size=6), st.integers(1, 9))
def test_so_many_are_solved_in_a_row(practice: int, bad: set[int], attempts: int) -> None:
    """In batches that double, and from the beginning once one fails."""
    with pytest.MonkeyPatch.context() as patch:
        recruited(patch, MEMBER)
        drawn = list[int]()
        how = {
            "practice": practice,
            "looks": LOOKS,
            "attempts": attempts,
            "noisy": False,
        }
        after, told = improved(first_stage(), NONE, drawing(bad, drawn), replays=1, **how)
    looks, *batches = drawn
    assert looks == LOOKS
    met, failures, in_a_row, size = 0, 0, 0, BATCH
    for count in batches:
        assert count == min(size, practice - in_a_row)
        here, met = set(range(met, met + count)), met + count
        if bad & here:
            failures, in_a_row, size = failures + 1, 0, BATCH
        else:
            in_a_row, size = in_a_row + count, 2 * size
    finished = in_a_row == practice
    assert failures == min(attempts, IDLE) or (finished and failures < attempts)
    practised: list[Practised] = of_kind(told, Practised)
    assert [e.in_a_row for e in practised] == [0] * failures + [practice] * finished
    assert {e.wanted for e in practised} == {practice}
    failed = len([i for i in bad if i < met])
    assert (after.skill is not None) == (met > failed)
    if after.skill is not None:
        assert len(after.missed) == failed
        assert len(after.solved) == met - failed


@settings(max_examples=6)
@given(
    st.integers(0, 20),
    st.sets(st.integers(0, 50), max_size=9),
    st.integers(1, 30),
    st.integers(0, 3),
)
@example(practice=10, bad={8, 17, 26, 37}, attempts=30, tests=0)
def test_where_nothing_is_tried_twice_the_first_skill_has_to_solve_more(
    practice: int, bad: set[int], attempts: int, tests: int
) -> None:
    """One after the other, so that nothing is asked once it is known that the skill fails."""
    with pytest.MonkeyPatch.context() as patch:
        recruited(patch, MEMBER)
        drawn = list[int]()
        how = {
            "practice": practice,
            "looks": LOOKS,
            "attempts": attempts,
            "repeats": False,
        }
        draw = drawing(bad, drawn)
        after, told = improved(first_stage(), GOOD[:tests], draw, replays=1, **how)
    looks, *batches = drawn
    assert looks == LOOKS
    assert set(batches) <= {1}
    practised: list[Practised] = of_kind(told, Practised)

    def enough(tried: int, succeeded: int, in_a_row: int) -> bool:
        wanted = practice
        if tried < FIRST * practice:
            wanted = int(FIRST * practice)
        elif succeeded >= LONG * practice:
            wanted = practice // 2
        return in_a_row >= wanted and tried >= tests

    tried = succeeded = in_a_row = 0
    results = [True] * tests + [i not in bad for i in range(len(batches))]
    for solved in results:
        if len(practised) < attempts:
            assert not enough(tried, succeeded, in_a_row)
        tried, succeeded = tried + 1, succeeded + solved
        in_a_row = in_a_row + 1 if solved else 0
    assert practised[-1].in_a_row == in_a_row
    assert enough(tried, succeeded, in_a_row) or len(practised) == attempts
    assert len(practised) <= attempts
    if after.skill is not None:
        assert len(after.solved) == sum(results)
        assert len(after.missed) == len(results) - sum(results)


def test_tests_come_before_practice(monkeypatch: pytest.MonkeyPatch) -> None:
    recruited(monkeypatch, MEMBER)
    watched, drawn = Watched(), list[int]()
    how = {"world_of": watched, "practice": 5, "looks": 2, "noisy": False}
    after, _ = improved(first_stage(), GOOD[:7], drawing(set(), drawn), **how)
    first, *others = watched.trials
    assert first.keys == keys(GOOD[:7])
    assert [len(each.keys) for each in others] == [3, 2]
    assert len(after.solved) == 12


@pytest.mark.parametrize(("attempts", "practice", "solved"), [(3, 4, 2), (24, 4, 2), (24, 1, 0)])
def test_what_nobody_can_solve_ends_a_stage_at_last(
    attempts: int, practice: int, solved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though fresh scenarios are solved in a row each time."""
    recruited(monkeypatch, MEMBER)
    drawn, tests = list[int](), GOOD[:solved].joined(BAD[:1])
    how = {"practice": practice, "looks": 2, "attempts": attempts, "noisy": False}
    after, told = improved(first_stage(), tests, drawing(set(), drawn), **how)
    practised: list[Practised] = of_kind(told, Practised)
    assert [e.in_a_row for e in practised] == [practice] * min(attempts, IDLE + 1)
    assert after.skill is not None
    assert keys(after.missed) == keys(BAD[:1])
    assert len(after.solved) == solved + sum(drawn[1:]) >= solved + practice
    assert len(of_kind(told, SkillAccepted)) == 1


@pytest.mark.parametrize("attempts", [4, 24])
def test_who_solves_nothing_at_all_is_given_up(
    attempts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    recruited(monkeypatch, MEMBER)
    draw = drawing(set(range(999)), [])
    how = {"practice": 4, "looks": 2, "noisy": False}
    after, told = improved(first_stage(), BAD[:2], draw, attempts=attempts, **how)
    assert [e.in_a_row for e in of_kind(told, Practised)] == [0] * min(attempts, IDLE)
    assert after.skill is None
    assert not len(after.solved) + len(after.missed)


@pytest.mark.parametrize("practice", [0, 3])
def test_where_nothing_is_seen_nobody_is_evolved_and_all_stays(practice: int) -> None:
    """As in a stage without tests, if nobody looks at fresh scenarios either."""
    how = {"looks": 0, "practice": practice, "attempts": 2}
    after, told = improved(first_stage(), NONE, along("near"), **how)
    assert after.skill is None
    assert not of_kind(told, SkillAccepted)


@pytest.mark.parametrize(("solved", "first"), [(DECISIVE, 1), (DECISIVE - 1, 2)])
def test_whether_success_is_chance_is_asked_once_enough_is_solved_to_tell(
    solved: int, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And else at the end, which is after two candidates here."""
    recruited(monkeypatch, MEMBER)
    how = {"practice": 0, "looks": 2, "attempts": 2, "replays": 1, "noisy": True}
    _, told = improved(first_stage(), GOOD[:solved].joined(BAD[:1]), drawing(set(), []), **how)
    asked = [isinstance(e, WorldAsked) and e.phase == "other noise" for e in told].index(True)
    assert len(of_kind(told[:asked], Practised)) == first


def test_a_candidate_that_solves_more_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each time something more is solved, as many candidates may fail again."""
    useless = [replace(nearly(-1.0 - i / 10), name=f"useless {i}") for i in range(2 * IDLE)]
    order = [*useless[: IDLE - 1], MEMBER, *useless[IDLE:]]
    recruited(monkeypatch, *order)
    how = {"practice": 0, "looks": 2, "attempts": 99, "noisy": False, "replays": 1}
    after, told = improved(first_stage(), GOOD[:1].joined(BAD[:3]), along("near"), **how)
    assert len(after.solved) == 1
    assert len(of_kind(told, Practised)) == IDLE - 1 + 1 + IDLE


def test_what_fails_in_practice_is_where_the_next_member_is_evolved(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It becomes M if nobody solves it, and W once somebody does."""
    far = replace(nearly(0.55), name="far")
    many = random_scenarios("perimeter", 300, seeded(3))
    ours, theirs = (try_skill(m, world_of(many)).succeeded for m in (MEMBER, far))
    tests, odd = many[ours][:4], many[theirs & ~ours][:3]
    assert len(odd) == 3
    left = recruited(monkeypatch, MEMBER, far)

    def draw(count: int, generator: Generator) -> Scenarios:
        return odd[torch.arange(count) % 3]

    how = {"practice": 3, "looks": 3, "attempts": 12, "noisy": False}
    after, told = improved(first_stage(), tests, draw, **how)
    assert not left
    assert after.skill is not None
    assert set(after.skill.sub_skills) == {MEMBER.name, far.name}
    assert set(keys(after.solved)) == set(keys(tests.joined(odd)))
    assert not len(after.missed)
    assert [e.in_a_row for e in of_kind(told, Practised)][-1] == 3


@pytest.mark.parametrize(
    ("repeats", "tried", "actions", "share"),
    [(False, 29, 90, FIRST), (False, 30, 49, 1.0), (False, 30, 50, 0.5), (True, 0, 90, 1.0)],
)
def test_few_trials_ask_for_more_in_a_row_and_many_successes_for_fewer(
    repeats: bool, tried: int, actions: int, share: float
) -> None:
    assert (FIRST, LONG) == (1.5, 2.5)
    state = state_of(MANY[:60], (), repeats=repeats, actions=(3,) * actions)
    setup = without_models(practice=20)
    state = replace(state, tried=torch.arange(60) < tried)
    assert _wanted(setup, state) == 20 * share
    waiting = replace(state, waiting=MANY[:30], in_a_row=10)
    assert _wanted(setup, waiting) == 40
