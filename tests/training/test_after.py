"""What is said of a training that has not reached its goal, in place of going on as before."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from told_by_runs import generation_rows
from trained import Trained

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.ground.asked import Purse
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, planned_run, read_run
from cgtorch.training import after
from cgtorch.training.after import USUAL, advice_after, only_return, unfinished, why_late

pytest.importorskip("gymnasium")


def planned(folder: Path, **own: Any) -> StoredRun:
    settings = RunSettings(domain="gymnasium:MountainCarContinuous-v0", **own)
    return planned_run(folder, settings, GymnasiumSettings("MountainCarContinuous-v0"))


def rows(*returns: float | None) -> list[dict[str, Any]]:
    every = [{"best": x, "mean": x, "low": x, "high": x} for x in returns]
    return [generation_rows(1, 9, [0.0])[0] | each for each in every]


def test_returns_that_are_all_the_same_show_no_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = planned(tmp_path)
    monkeypatch.setattr(after, "read_log", lambda folder: rows(0.0, 0.0))
    assert advice_after(run).startswith("all individuals of all generations had a return of 0, so")
    assert "give rewards for progress" in advice_after(run)
    monkeypatch.setattr(after, "read_log", lambda folder: rows(0.0, 0.1))
    assert advice_after(run) == USUAL
    imagined = replace(run, settings=replace(run.settings, models="learned"))
    monkeypatch.setattr(after, "read_log", lambda folder: rows(0.0, 0.0))
    assert advice_after(imagined) == USUAL, "as what is imagined may be wrong"


def test_the_only_return_is_that_of_all_individuals() -> None:
    assert only_return(rows(-3.0, -3.0)) == -3
    assert only_return([{"event": "mean", "best": 4}, *rows(-3.0)]) == -3
    assert only_return([]) is None
    assert only_return(rows(None)) is None, "without a return"
    assert only_return(rows(None, 0.0)) is None
    assert only_return([rows(0.0)[0] | {"best": 1.0}]) is None


def test_without_rewards_the_search_goes_on(trained: Trained) -> None:
    assert advice_after(read_run(trained.folder)) == USUAL


def test_episodes_that_do_not_end_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = planned(tmp_path)
    episodes: Any = run.domain.episodes  # type: ignore[attr-defined]
    monkeypatch.setattr(episodes, "_unended", 4321)
    monkeypatch.setattr(after, "read_log", lambda folder: [])
    assert advice_after(run) == USUAL, "as it has a limit"
    monkeypatch.setattr(episodes, "most_steps", float("inf"))
    assert advice_after(run) == (
        "an episode of 4,321 steps had not ended, so it had no return; train anew with a limit of "
        "steps (--env max_episode_steps=300)"
    )
    monkeypatch.setattr(episodes, "_unended", 999)
    assert advice_after(run) == USUAL


def test_why_there_is_no_skill_at_the_end_of_the_time_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    domain = planned(tmp_path).domain
    assert why_late(domain, Purse()).endswith("; give more (minutes, --minutes)")
    hung = Purse(unreturned="step 7 of environment 'a:B-v0' has not returned for 61 s")
    assert why_late(domain, hung) == f", as {hung.unreturned}; mend that"
    monkeypatch.setattr(domain.pictures, "advice", lambda self: "an episode had not ended")
    assert why_late(domain, Purse()) == ", as an episode had not ended"


@pytest.mark.parametrize(
    ("rewards", "solved", "says"),
    [
        (False, 0, "; no individual of 3 generations has succeeded, so look whether success is"),
        (False, 1, "has not finished its first round in time; continue"),
        (True, 0, "has not finished its first round in time; continue"),
    ],
)
def test_a_search_in_which_nothing_succeeds_is_told(
    rewards: bool, solved: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = [
        row | {"solved_w": 0, "solved_m": solved} for row in generation_rows(3, 9, [0.0, 0.1, 0.2])
    ]
    monkeypatch.setattr(after, "read_log", lambda folder: begun)
    monkeypatch.setattr(after, "rewarded", lambda domain: rewards)
    assert says in unfinished(planned(tmp_path))
