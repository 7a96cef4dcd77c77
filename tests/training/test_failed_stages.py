"""Stages that find no skill: others go on, and the stage comes back after them."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import TABLE

from cgtorch.improvement.events import Event, SkillAccepted, StageFailed
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.trial import first_percepts
from cgtorch.runs.log import history_of, read_log
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training import train as module
from cgtorch.training.context import Training
from cgtorch.training.train import NotImprovedError, next_stage, train

NAMES = ("A", "B", "C")


@pytest.mark.parametrize(
    ("history", "following"),
    [
        ("", ("A", 0)),
        ("a", ("B", 0)),
        ("A", ("B", 0)),
        ("aB", ("C", 0)),
        ("aBC", ("A", 1)),
        ("aBCA", None),
        ("aBCa", None),
        ("abC", ("A", 1)),
        ("abCa", ("B", 1)),
        ("abCaB", ("A", 2)),
        ("abCaBa", None),
        ("abc", None),
        ("ABC", None),
    ],
)
def test_stages_come_in_order_and_those_that_failed_after_some_other(
    history: str, following: tuple[str, int] | None
) -> None:
    """A small letter is a stage that failed, a large one a stage that was made."""
    told = [("result" if s.isupper() else "failed", s.upper()) for s in history]
    made = [stage for event, stage in told if event == "result"]
    assert next_stage(NAMES, made, told) == following


@given(st.lists(st.booleans(), max_size=40))
def test_it_ends_whatever_happens(luck: list[bool]) -> None:
    history, made, fortune = list[tuple[str, str]](), list[str](), iter(luck)
    while found := next_stage(NAMES, made, history):
        good = next(fortune, False)
        history.append(("result" if good else "failed", found[0]))
        made += [found[0]] * good
        assert len(history) <= 9
    assert set(made) == set(NAMES) or history[-1][0] == "failed"


class Fails:
    """A method that finds a skill unless a stage is among those that fail, once each."""

    def __init__(self, *failing: str) -> None:
        self.failing, self.seen = list(failing), list[tuple[str, int, int]]()

    def __call__(self, setup: Setup[Any], progress: Progress[Any], tests: Any, draw: Any) -> Any:
        fresh = draw(1, setup.generator)
        self.seen.append((setup.name, len(progress.solved), int(fresh.seed[0])))
        if setup.name in self.failing:
            self.failing.remove(setup.name)
            return progress
        everywhere = torch.ones(len(tests), dtype=torch.bool)
        skill = replace(nearly(0.5), name=setup.name)
        setup.watch(SkillAccepted(setup.name, skill, tests, everywhere, ~everywhere, everywhere, 1))
        solved = progress.solved.joined(tests)
        seen = first_percepts(TABLE.world(solved))
        return replace(progress, skill=skill, solved=solved, seen=seen)


@pytest.fixture
def run(tmp_path: Path) -> StoredRun:
    (tmp_path / "run.json").write_text("{}")
    settings = RunSettings(models="none", practice=4)
    return StoredRun(tmp_path, settings, TABLE, paper_actions(), True)


def trained(run: StoredRun, method: Fails, monkeypatch: pytest.MonkeyPatch) -> list[Event]:
    events = list[Event]()
    monkeypatch.setitem(module.METHODS, run.settings.method, method)
    train(Training(run, events.append, lambda message: nullcontext()), "S2")
    return events


def test_a_stage_that_fails_comes_back_with_other_numbers(
    run: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = Fails("S0")
    events = trained(run, method, monkeypatch)
    assert [(name, solved) for name, solved, _ in method.seen] == [
        ("S0", 0), ("S1", 0), ("S2", 5), ("S0", 10),
    ]  # fmt: skip
    assert method.seen[0][2] != method.seen[3][2]
    assert [event.stage for event in events if isinstance(event, StageFailed)] == ["S0"]
    assert run.stages == ("S1", "S2", "S0")
    assert [result["stage"] for result in run.results] == ["S1", "S2", "S0"]
    assert [row["stage"] for row in read_log(run.folder) if row["event"] == "failed"] == ["S0"]
    assert not (run.folder / "journal").exists()


def test_a_run_goes_on_after_a_failure_where_it_was(
    run: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(NotImprovedError, match="stage S0 and S1 found no skill"):
        trained(run, Fails("S0", "S1", "S1", "S0"), monkeypatch)
    assert run.stages == ("S2",)
    method = Fails()
    with pytest.raises(NotImprovedError, match="stage S0 and S1 found no skill"):
        trained(run, method, monkeypatch)
    assert not method.seen


def test_a_stage_that_was_set_aside_has_not_failed(tmp_path: Path) -> None:
    lines = [
        '{"event": "failed", "time": 1.0, "stage": "S0", "attempts": 2}',
        '{"event": "result", "time": 1.0, "stage": "S1"}',
        '{"event": "changed", "time": 1.0, "stage": "S0", "changed": {}, "set_aside": "1"}',
    ]
    (tmp_path / "log.jsonl").write_text("\n".join(lines) + "\n")
    assert history_of(tmp_path) == [("result", "S1")]
