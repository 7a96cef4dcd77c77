"""Stages one after the other: what is told, written and gone on from, also by several ranks."""

import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from members import nearly
from reaching import TABLE
from support import seeded

from cgtorch.graphs import load_skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import Purse
from cgtorch.ground.errors import RunError
from cgtorch.improvement.events import Event, Practised, SkillAccepted, StageStarted
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.trial import first_percepts
from cgtorch.native.rank_processes import in_ranks
from cgtorch.runs.log import read_log
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.storage import save_progress
from cgtorch.runs.stored_run import SKILL, StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import Scenarios
from cgtorch.training import train as module
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training
from cgtorch.training.evaluate import Score
from cgtorch.training.train import (
    NotImprovedError,
    counts,
    finished_generations,
    stage_generator,
    stages_to_make,
    train,
)


class Halves:
    """A method whose skill solves the first three tests, and a list of what it was given."""

    def __init__(self, spends: bool = False) -> None:
        self.spends, self.given = spends, list[tuple[str, Progress[Any], list[int]]]()

    def __call__(self, setup: Setup[Any], progress: Progress[Any], tests: Any, draw: Any) -> Any:
        assert setup.name not in [name for name, *_ in self.given], "it is made already"
        fresh: Scenarios = draw(3, setup.generator)
        self.given.append((setup.name, progress, fresh.seed.tolist()))
        skill = replace(nearly(0.5), name=setup.name)
        setup.watch(Practised(setup.name, skill, 3, 4))
        every = tests.joined(progress.missed)
        succeeded = torch.arange(len(every)) < 3
        keep = torch.zeros(len(every), dtype=torch.bool)
        about = every, succeeded, keep, ~keep
        setup.watch(SkillAccepted(setup.name, skill, *about, 1.5))
        solved, missed = progress.solved.joined(every[succeeded]), every[~succeeded]
        seen = first_percepts(TABLE.world(solved.joined(missed)))
        setup.purse.exhausted = self.spends
        return replace(progress, skill=skill, solved=solved, missed=missed, seen=seen)


@pytest.fixture
def run(tmp_path: Path) -> StoredRun:
    (tmp_path / "run.json").write_text("{}")
    settings = RunSettings(models="none", practice=4, attempts=7)
    return StoredRun(tmp_path, settings, TABLE, paper_actions(), True)


@pytest.fixture
def method(monkeypatch: pytest.MonkeyPatch) -> Halves:
    """The method of all runs."""
    made = Halves()
    monkeypatch.setitem(module.METHODS, "compose", made)
    return made


def training_of(run: StoredRun, events: list[Event], **about: Any) -> Training:
    return Training(run, events.append, lambda message: nullcontext(), **about)


def test_a_stage_tells_how_much_there_is_to_keep_and_to_solve(
    run: StoredRun, method: Halves
) -> None:
    events: list[Event] = []
    train(training_of(run, events), "S2")
    started = [event for event in events if isinstance(event, StageStarted)]
    names = ("S0", "S1", "S2")
    assert started == [
        StageStarted(name, names, size_w, size_m, 7)
        for name, size_w, size_m in zip(names, (0, 3, 6), (5, 7, 9), strict=True)
    ]
    (ended,) = [row for row in read_log(run.folder) if row["event"] == "ended"]
    assert ended["stage"] == "S2"


def test_another_training_goes_on_from_the_last_stage(run: StoredRun, method: Halves) -> None:
    """It returns the results of the stages that were asked for, and removes what is not needed."""
    train(training_of(run, []), "S1")
    left = run.folder / "journal" / "S1"
    left.mkdir(parents=True)  # as of a process that was killed
    (third,) = train(training_of(run, []), "S2")[2:]
    assert [name for name, *_ in method.given] == ["S0", "S1", "S2"]
    assert not left.parent.exists()
    _, before, _ = method.given[-1]
    assert (before.skill and before.skill.name, len(before.solved), len(before.missed)) == (
        "S1", 6, 4,
    )  # fmt: skip
    assert (third["stage"], third["w_size"], third["earlier_failures"]) == ("S2", 6, 4)
    assert [result["stage"] for result in train(training_of(run, []), "S1")] == ["S0", "S1"]
    assert len(method.given) == 3


def test_an_interruption_leaves_the_last_skill_that_was_tried(
    run: StoredRun, method: Halves
) -> None:
    def stop(event: Event) -> None:
        if isinstance(event, SkillAccepted):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(Training(run, stop, lambda message: nullcontext()), "S0")
    assert load_skill(run.folder / "journal" / "S0" / SKILL, run.actions).name == "S0"
    assert run.stages == ()


def test_a_stage_that_tried_nothing_leaves_no_skill(
    run: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stops(*given: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setitem(module.METHODS, "compose", stops)
    with pytest.raises(KeyboardInterrupt):
        train(training_of(run, []), "S0")
    assert not list(run.folder.rglob(SKILL))


@pytest.mark.parametrize("spends", [False, True])
def test_ranks_wait_until_the_first_has_written_a_stage(
    spends: bool, run: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others would make it once more, or return less; here the first one takes its time."""

    def slowly(*about: Any) -> None:
        time.sleep(0.2)
        save_progress(*about)

    found = list[int]()
    monkeypatch.setattr(module, "save_progress", slowly)

    def work() -> None:
        method = Halves(spends)
        monkeypatch.setitem(module.METHODS, "compose", method)
        results = train(training_of(run, []), "S1")
        counted = torch.tensor([len(method.given), len(results)])
        found.extend(ranks.all_gather(counted, 4).tolist())

    in_ranks(work, 2)
    assert found == ([1] * 4 if spends else [2] * 4)


def test_a_round_draws_by_its_own_generator(run: StoredRun, method: Halves) -> None:
    (result,) = train_until(training_of(run, []), Goal(target=0.99, rounds=1))
    ((name, _, drawn),) = method.given
    assert name == result["stage"] == "auto-1"
    assert result["scenarios"] == result["fresh"]["scenarios"] == run.kind
    zeros = "targets", "targets_succeeded", "earlier_failures", "earlier_failures_succeeded"
    assert [result[each] for each in zeros] == [0] * 4
    generator = stage_generator(TABLE, run.settings.seed, "auto-1")
    assert drawn == TABLE.draw(run.kind, 3, generator).seed.tolist()


def test_stages_of_a_run_in_rounds_are_its_own_or_none(run: StoredRun, method: Halves) -> None:
    train(training_of(run, []), "S1")
    train_until(training_of(run, []), Goal(target=0.99, rounds=1))
    assert run.rounds == ("auto-1",)
    assert stages_to_make(run, "S1") == ("S0", "S1")
    with pytest.raises(RunError, match="has continued in rounds and cannot make a single stage"):
        stages_to_make(run, "S2")


def test_seeds_are_those_of_earlier_runs() -> None:
    """As a run that goes on, or is made again, would have other scenarios otherwise."""
    seeds = [
        stage_generator(TABLE, *about).initial_seed()
        for about in ((0, "S0"), (2, "S3"), (2, "S3", 2), (0, "auto-1"), (3, "auto-12"))
    ]
    assert seeds == [1, 2_000_010, 2_600_010, 500_001, 3_500_021]


def test_what_was_too_little_is_said(run: StoredRun) -> None:
    def nothing(setup: Any, progress: Any, *given: Any) -> Any:
        return progress

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(module.METHODS, "compose", nothing)
        with pytest.raises(NotImprovedError, match="within 7 attempts; raise attempts, gen"):
            train(training_of(run, []), "S0")
        late = training_of(run, [], purse=Purse(until=time.monotonic() - 1))
        with pytest.raises(NotImprovedError, match="the time was over before stage S0 had a"):
            module._stage(late, "S0", ("S0",), Progress(None, *none(), None), 0)


def none() -> tuple[Scenarios, Scenarios]:
    return TABLE.draw("near", 0, seeded(0)), TABLE.draw("near", 0, seeded(0))


def test_generations_of_all_stages_add_up(run: StoredRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StoredRun, "results", [{"generations": 3}, {"generations": 14}])
    assert finished_generations(run) == 17


def test_a_score_is_told_with_its_mean_where_there_are_returns() -> None:
    score = Score(None, torch.zeros(4, 2), torch.tensor([True, False, True, True]))
    assert counts("near", score) == {"scenarios": "near", "tried": 4, "succeeded": 3}
    returns = torch.tensor([1.0, 2.0, 3.0, 6.0])
    found = counts("any", replace(score, returns=returns))
    error = pytest.approx((14 / 3 / 4) ** 0.5)
    assert found == {
        "scenarios": "any", "tried": 4, "succeeded": 3, "mean_return": 3.0, "error": error,
    }  # fmt: skip
