"""The best skill of an interrupted round stays until the search has come as far again."""

import json
import time
from contextlib import nullcontext
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import pytest
from lottery import PaidTombola
from reaching import TABLE
from support import create_run, same_nodes

from cgtorch.graphs import Skill, load_skill
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.improvement.events import Event, GenerationDone, MeanTested
from cgtorch.runs.chosen import folder_of_last
from cgtorch.runs.journal import recalled_generations
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import SKILL, StoredRun, planned_run, write_run
from cgtorch.training import train
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training
from cgtorch.training.kept import kept_skill

GOAL, NAME = Goal(target=1e6, rounds=1), "auto-1"
MEANS = 3  # of which the last one is told before the interruption


def trained(run: StoredRun, means: int, late: bool) -> None:
    """Train until so many means are told; then the time is over, or somebody interrupts."""
    told = list[Event]()

    def watch(event: Event) -> None:
        told.extend([event] if isinstance(event, MeanTested) else [])
        if len(told) == means:
            training.purse.until = time.monotonic() if late else training.purse.until
            if not late:
                raise KeyboardInterrupt

    training = Training(run, watch, lambda message: nullcontext())
    train_until(training, GOAL)


@pytest.fixture
def interrupted(tmp_path: Path) -> tuple[StoredRun, Skill]:
    """A run without a checkpoint, as processes that share the work have none at an end."""
    settings = RunSettings(domain="mine:Tombola", population=12, generations=3, attempts=3)
    run = planned_run(tmp_path / "run", settings, domain=PaidTombola())
    write_run(run)
    with pytest.raises(KeyboardInterrupt):
        trained(run, MEANS, late=False)
    for path in run.folder.glob("journal/*/*.safetensors"):
        path.unlink()
    kept = kept_skill(run, NAME, NAME)
    assert kept is not None
    assert kept.episodes > 0
    return run, kept.skill


def test_it_is_what_has_solved_most_when_the_time_is_over(tmp_path: Path) -> None:
    settings = RunSettings(models="none", population=40, generations=9)
    run = replace(create_run(tmp_path / "run", settings), domain=TABLE)
    done = list[GenerationDone]()

    def watch(event: Event) -> None:
        if isinstance(event, GenerationDone):
            done.append(event)
            training.purse.until = time.monotonic() + 99 * (len(done) < 3)

    training = Training(run, watch, lambda message: nullcontext())
    assert train_until(training, Goal(target=0.99, rounds=1)) == []
    assert same_nodes(skill_now(run).graph, done[-1].generation.champion.graphs)
    assert (len(done), recalled_generations(run.folder)) == (3, 2)


@pytest.mark.parametrize("late", [True, False])
def test_a_search_may_be_broken_off_anywhere_by_the_end_of_the_time_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: bool
) -> None:
    def spent(*_: Any) -> Any:
        training.purse.until = time.monotonic() if late else inf
        raise BudgetSpentError("nothing is left")

    monkeypatch.setitem(train.METHODS, "compose", spent)
    run = replace(create_run(tmp_path / "run", RunSettings(models="none")), domain=TABLE)
    training = Training(run, lambda event: None, lambda message: nullcontext())
    with nullcontext() if late else pytest.raises(BudgetSpentError, match="nothing is left"):
        assert train_until(training, Goal(target=0.99, rounds=1)) == []
    assert training.purse.exhausted is late


def skill_now(run: StoredRun) -> Skill:
    folder = folder_of_last(run)
    assert folder is not None
    return load_skill(folder / SKILL, run.actions)


def test_it_stays_at_another_interruption(interrupted: tuple[StoredRun, Skill]) -> None:
    run, skill = interrupted
    with pytest.raises(KeyboardInterrupt):
        trained(run, 1, late=False)
    assert same_nodes(skill_now(run).graph, skill.graph)


def test_it_is_the_skill_of_a_round_whose_time_is_over_too_soon(
    interrupted: tuple[StoredRun, Skill],
) -> None:
    run, skill = interrupted
    trained(run, 1, late=True)
    assert run.rounds == (NAME,)
    assert same_nodes(skill_now(run).graph, skill.graph)
    accepted = [json.loads(row) for row in (run.folder / "log.jsonl").read_text().splitlines()]
    assert [row["skill"] for row in accepted if row["event"] == "accepted"] == [NAME]
