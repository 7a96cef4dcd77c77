"""A kind of scenarios that comes again is rehearsed, and improved only if the skill got worse."""

from typing import Any

import pytest
import torch
from members import nearly
from reaching import world_of
from support import seeded
from torch import Generator
from watched import NONE, first_stage, keys, known, of_kind, recruited, stage_of, without_models

from cgtorch.graphs import same_behaviour
from cgtorch.ground.asked import Purse
from cgtorch.improvement import rehearse as module
from cgtorch.improvement.events import Event, Practised, SkillAccepted
from cgtorch.improvement.rehearse import FEWER, rehearse
from cgtorch.improvement.setup import Progress
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import Scenarios, random_scenarios

SKILL = nearly(0.3)
MANY = random_scenarios("near", 200, seeded(0))
_DONE = try_skill(SKILL, world_of(MANY)).succeeded
GOOD, BAD = MANY[_DONE], MANY[~_DONE]
FRESH = 10  # scenarios of a rehearsal


def rehearsed(
    good: list[bool],
    share: float,
    progress: Progress[Scenarios] | None = None,
    tests: Scenarios = NONE,
    **changed: Any,
) -> tuple[Progress[Scenarios], list[Event]]:
    """The result of a stage that draws scenarios of which these are solved, and its events."""
    told: list[Event] = []
    solves = torch.tensor(good)
    drawn = GOOD[: len(good)].joined(BAD[:FRESH])
    rows = torch.where(solves, torch.arange(len(good)), len(good) + (~solves).cumsum(0) - 1)

    def draw(count: int, generator: Generator) -> Scenarios:
        return drawn[rows[:count]]

    setup = stage_of(without_models(practice=len(good) * FEWER, **changed), told.append)
    progress = known(world_of, SKILL, NONE) if progress is None else progress
    return rehearse(setup, progress, SKILL, tests, draw, share), told


@pytest.fixture
def improved(monkeypatch: pytest.MonkeyPatch) -> list[Progress[Scenarios]]:
    """With what progress stages are improved in the usual way."""
    seen: list[Progress[Scenarios]] = []

    def improve(setup: Any, progress: Progress[Scenarios], *about: object) -> Progress[Scenarios]:
        seen.append(progress)
        return progress

    monkeypatch.setattr(module, "improve", improve)
    return seen


def test_a_skill_that_is_as_good_as_before_stays(improved: list[Progress[Scenarios]]) -> None:
    """Its result tells of the tests, and of what it missed earlier, which is not tried again."""
    good = [True] * FRESH
    before = known(world_of, SKILL, GOOD[20:23], BAD[:2])
    after, told = rehearsed(good, 1.0, before, GOOD[30:32].joined(BAD[5:6]))
    assert not improved
    assert after.skill is not None
    assert after.skill.name == "S1"
    assert same_behaviour(after.skill, SKILL)
    assert keys(after.solved) == keys(GOOD[:FRESH].joined(GOOD[30:32], GOOD[20:23]))
    assert keys(after.missed) == keys(BAD[5:6].joined(BAD[:2]))
    assert after.seen is not None
    both = after.solved.joined(after.missed)
    assert torch.equal(after.seen, first_percepts(world_of(both)))
    (accepted,) = of_kind(told, SkillAccepted)
    assert accepted.skill is after.skill
    assert accepted.parent == SKILL.name
    tried = GOOD[:FRESH].joined(GOOD[30:32], BAD[5:6])
    assert keys(accepted.scenarios) == keys(tried.joined(BAD[:2], GOOD[20:23]))
    assert accepted.keep.nonzero()[:, 0].tolist() == [15, 16, 17]
    assert accepted.succeeded.tolist() == [*good, True, True, *[False] * 3, *[True] * 3]
    assert accepted.targets.nonzero()[:, 0].tolist() == [10, 11, 12, 13, 14]


def test_tests_do_not_tell_whether_it_is_worse(improved: list[Progress[Scenarios]]) -> None:
    good = [True] * 6 + [False] * 4
    _, told = rehearsed(good, 0.9, tests=GOOD[30:34])
    assert len(improved) == 1
    (practised,) = of_kind(told, Practised)
    assert (practised.in_a_row, practised.wanted) == (0, FRESH)


def test_a_part_of_a_fifth_counts(improved: list[Progress[Scenarios]]) -> None:
    drawn: list[int] = []

    def draw(count: int, generator: Generator) -> Scenarios:
        drawn.append(count)
        return GOOD[:count]

    setup = stage_of(without_models(practice=2 * FEWER + 1))
    rehearse(setup, known(world_of, SKILL, NONE), SKILL, NONE, draw, 1.0)
    assert drawn == [3]
    assert not improved


def test_percepts_begin_with_a_rehearsal_if_there_are_none(
    improved: list[Progress[Scenarios]],
) -> None:
    after, _ = rehearsed([True, False, True, True], 0.5, first_stage(SKILL))
    assert not improved
    assert after.seen is not None
    both = after.solved.joined(after.missed)
    assert torch.equal(after.seen, first_percepts(world_of(both)))


def test_what_it_misses_is_handed_on(improved: list[Progress[Scenarios]]) -> None:
    good = [True, False, True, True, False, True, True, True, True, True]
    after, told = rehearsed(good, 0.8, known(world_of, SKILL, GOOD[20:23], BAD[8:9]))
    assert not improved
    assert keys(after.missed) == keys(BAD[:2].joined(BAD[8:9]))
    assert len(after.solved) == 8 + 3
    (practised,) = of_kind(told, Practised)
    assert (practised.in_a_row, practised.wanted) == (5, FRESH)
    assert after.seen is not None
    assert len(after.seen) == len(after.solved) + len(after.missed)


@pytest.mark.parametrize(("solved", "share", "worse"), [
    (10, 1.0, False),
    (9, 1.0, True),  # with 95 % confidence, at most 98.2 %
    (9, 0.98, False),
    (6, 0.84, True),  # at most 83.2 %
    (6, 0.83, False),
    (0, 0.0, True),  # there is nothing to accept
])  # fmt: skip
def test_it_is_improved_if_it_is_significantly_worse(
    solved: int, share: float, worse: bool, improved: list[Progress[Scenarios]]
) -> None:
    good = [True] * solved + [False] * (FRESH - solved)
    after, told = rehearsed(good, share)
    assert bool(improved) == worse
    assert bool(of_kind(told, SkillAccepted)) != worse
    if worse:
        assert after is improved[0]
        assert (len(after.solved), len(after.missed)) == (solved, FRESH - solved)


@pytest.mark.parametrize("count", range(1, 41))
def test_a_skill_that_solves_all_is_not_worse(
    count: int, improved: list[Progress[Scenarios]]
) -> None:
    """However the ends of intervals are rounded."""
    _, told = rehearsed([True] * count, 1.0)
    assert not improved
    assert len(of_kind(told, SkillAccepted)) == 1


def test_a_skill_that_got_worse_is_improved_on_what_it_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    left = recruited(monkeypatch, nearly(0.35))
    after, _ = rehearsed([True] * 9 + [False], 1.0, attempts=2)
    assert not left  # who may solve it
    assert after.skill is not None
    assert after.skill.name in ("S1", SKILL.name)


def test_without_a_budget_nothing_changes(improved: list[Progress[Scenarios]]) -> None:
    before = first_stage(SKILL)
    after, told = rehearsed([True] * FRESH, 1.0, before, purse=Purse({"episodes": 3}))
    assert after is before
    assert not improved
    assert not told
