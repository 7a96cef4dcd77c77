"""What is said of a training that has not reached its goal, in place of going on as before."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from told_by_runs import generation_rows
from trained import Trained

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, planned_run, read_run
from cgtorch.training import after
from cgtorch.training.after import USUAL, advice_after, only_return

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
