"""The tests at a round's end: how many scenarios they have, what they tell and decide."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
from members import nearly
from reaching import TABLE
from support import random_skill, seeded
from walking import Walking

from cgtorch.graphs import Skill
from cgtorch.improvement.events import Event, FreshTested, Practised, StageStarted
from cgtorch.improvement.setup import Progress
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training import auto
from cgtorch.training import train as module
from cgtorch.training.auto import (
    DECISIVE_EPISODES,
    EPISODES,
    SHARE,
    _mean_tested,
    _tested,
    train_until,
)
from cgtorch.training.context import Training
from cgtorch.training.train import NotImprovedError

RUN = StoredRun(Path("none"), RunSettings(models="none", scenarios="near"), TABLE, paper_actions())
NONE = RUN.like()


class Told(list[Event]):
    """What is told, instead of a log."""

    def training(self, run: StoredRun) -> Training:
        training = Training(run, self.append, lambda message: nullcontext())
        object.__setattr__(training, "log", lambda event: None)
        return training


def progress_with(skill: Skill | None) -> Progress[Any]:
    return Progress(skill, NONE, NONE, None)


@pytest.mark.parametrize(("decisions", "met"), [(0, True), (10**4, False)])
def test_a_second_test_decides_and_all_that_was_tried_is_kept(decisions: int, met: bool) -> None:
    """The more tests have decided before, the surer it has to be."""
    told, skill, goal = Told(), nearly(0.3), Goal(target=0.6)
    about = told.training(RUN), goal, "auto-3", decisions
    after, scores, found = _tested(*about, progress_with(skill), seeded(1))
    assert [score.tried for score in scores] == [goal.screening, goal.decisive]
    assert len(after.solved) == sum(score.successes for score in scores)
    assert len(after.missed) == sum(score.tried - score.successes for score in scores)
    assert told == [
        FreshTested("auto-3", skill.name, score.successes, score.tried, 0.6, decisive)
        for score, decisive in zip(scores, (False, True), strict=True)
    ]
    assert found is met


def test_a_first_test_that_is_not_good_enough_is_the_only_one() -> None:
    told = Told()
    goal = Goal(target=0.95)
    _, scores, met = _tested(
        told.training(RUN), goal, "auto-1", 0, progress_with(nearly(0.3)), seeded(1)
    )
    assert len(scores) == len(told) == 1
    assert not met


@pytest.mark.parametrize("target", [1e-4, 0.01])
def test_a_target_that_nearly_anything_reaches_is_not_reached_by_nothing(target: float) -> None:
    told = Told()
    about = told.training(RUN), Goal(target=target), "auto-1", 0
    _, (score,), met = _tested(*about, progress_with(None), seeded(1))
    assert (score.successes, met) == (0, False)


WALKING = Walking()
WALKS = StoredRun(Path("none"), RunSettings(), WALKING, WALKING.actions())
SKILL = random_skill(3, "walk", WALKING.actions())


@pytest.mark.parametrize(
    ("played", "counts"),
    [
        (0, (EPISODES, DECISIVE_EPISODES)),
        (150 * SHARE, (150, DECISIVE_EPISODES)),
        (250 * SHARE + SHARE - 1, (250, 250)),
        (10**6, (300, 300)),
    ],
)
def test_the_more_a_search_has_played_the_longer_are_the_tests_of_a_mean(
    played: int, counts: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(auto, "MOST_EPISODES", 300)
    told, goal = Told(), Goal(target=-1e3)
    scores, met = _mean_tested(told.training(WALKS), goal, "auto-1", 0, SKILL, played)
    assert tuple(score.tried for score in scores) == counts
    assert told == [
        FreshTested(
            "auto-1", "walk", each.successes, each.tried, -1e3, last, each.mean_return, each.error
        )
        for each, last in zip(scores, (False, True), strict=True)
    ]
    assert met


def test_a_mean_below_the_target_is_tested_once() -> None:
    scores, met = _mean_tested(Told().training(WALKS), Goal(target=1.0), "auto-1", 0, SKILL, 0)
    assert ([score.tried for score in scores], met) == ([EPISODES], False)


def test_a_mean_that_later_decisions_doubt_is_not_reached() -> None:
    (first, second), _ = _mean_tested(
        Told().training(WALKS), Goal(target=-1e3), "auto-1", 0, SKILL, 0
    )
    assert second.mean_return is not None
    assert second.error is not None
    target = min(second.mean_return - 1.5 * second.error, first.mean_return or 0)
    for decisions, met in ((0, True), (10**4, False)):
        goal = Goal(target=target)
        assert _mean_tested(Told().training(WALKS), goal, "auto-1", decisions, SKILL, 0)[1] is met


def practises(setup: Any, progress: Any, *given: Any) -> Any:
    """A method that finds a skill."""
    setup.watch(Practised(setup.name, SKILL, 2, 3))
    return replace(progress, skill=SKILL)


def test_where_nothing_was_tested_no_mean_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a robot with rewards."""
    (tmp_path / "run.json").write_text("{}")
    monkeypatch.setitem(module.METHODS, "compose", practises)
    run = replace(WALKS, folder=tmp_path, repeats=False)
    training = Training(run, lambda event: None, lambda message: nullcontext())
    (result,) = train_until(training, Goal(target=0.0, rounds=1))
    assert result["mean_holds"] is False
    assert [result[each] for each in ("fresh", "overall", "decisive")] == [None] * 3
    assert result["in_a_row"] == 2


def test_a_round_without_a_skill_ends_the_training_once_its_budget_is_spent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.json").write_text("{}")
    run = replace(RUN, folder=tmp_path)

    def nothing(setup: Any, progress: Any, *given: Any) -> Any:
        setup.purse.exhausted = spent
        return progress

    monkeypatch.setitem(module.METHODS, "compose", nothing)
    for spent in (True, False):
        training = Training(run, lambda event: None, lambda message: nullcontext())
        if spent:
            assert train_until(training, Goal(rounds=1)) == []
        else:
            with pytest.raises(NotImprovedError, match="stage auto-1 found no skill"):
                train_until(training, Goal(rounds=1))


def test_a_mean_that_is_the_target_itself_is_tested_again() -> None:
    (first,), _ = _mean_tested(Told().training(WALKS), Goal(target=1.0), "auto-1", 0, SKILL, 0)
    for more, tests in ((0.0, 2), (1e-6, 1)):
        goal = Goal(target=fmean(first.values.tolist()) + more)
        scores, _ = _mean_tested(Told().training(WALKS), goal, "auto-1", 0, SKILL, 0)
        assert len(scores) == tests


def test_each_round_is_told_as_it_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.json").write_text("{}")
    monkeypatch.setitem(module.METHODS, "compose", practises)
    told = Told()
    run = replace(WALKS, folder=tmp_path, repeats=False)
    training = Training(run, told.append, lambda message: nullcontext())
    train_until(training, Goal(rounds=2))
    attempts = training.attempts
    assert [event for event in told if isinstance(event, StageStarted)] == [
        StageStarted("auto-1", ("auto-1",), 0, 0, attempts),
        StageStarted("auto-2", ("auto-1", "auto-2"), 0, 0, attempts),
    ]
