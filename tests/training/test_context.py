"""What improvement gets of a run's settings, and the models that a run begins with."""

import itertools
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from reaching import TABLE
from support import create_run
from told_by_runs import asked_at_start
from trained import SMALL
from walking import Walking

from cgtorch.domains.exploration import EXPLORATION
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.improvement.events import Event, ModelsFitted, WorldAsked
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.simulation import Recording
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.context import Training
from cgtorch.training.start import initial_progress, recall_spent

RUN = StoredRun(Path("none"), RunSettings(), TABLE, paper_actions())
BRIEF = SMALL


def ignore(event: Event) -> None:
    """Nobody watches."""


def training_of(run: StoredRun, purse: Purse | None = None) -> Training:
    return Training(run, ignore, lambda message: nullcontext(), purse=purse or Purse())


@pytest.mark.parametrize(
    ("repeats", "chosen", "stage", "rounds"),
    [(True, 0, 150, 150), (False, 0, 10, 20), (True, 7, 7, 7), (False, 7, 7, 7)],
)
def test_so_many_fresh_scenarios_are_to_be_solved_in_a_row(
    repeats: bool, chosen: int, stage: int, rounds: int
) -> None:
    run = replace(RUN, settings=RunSettings(practice=chosen), repeats=repeats)
    training = training_of(run)
    assert [training.practice(name) for name in ("S0", "S3", "auto-1")] == [stage, stage, rounds]
    for name in ("S0", "auto-1"):
        assert training.setup(name).practice == training.practice(name)
        assert training.setup(name).repeats == repeats


@pytest.mark.parametrize("chosen", [0, 7])
def test_with_rewards_there_is_no_practice(chosen: int) -> None:
    """Rounds try skills on fresh episodes by themselves."""
    domain = Walking()
    run = StoredRun(Path("none"), RunSettings(practice=chosen), domain, domain.actions())
    setup = training_of(run).setup("auto-1")
    assert (setup.practice, setup.looks) == (0, 0)


def test_all_that_is_asked_is_paid_from_one_purse() -> None:
    training = training_of(RUN, Purse({"motions": 3}))
    assert training.setup("S0").purse is training.purse


def explored(folder: Path, **limits: float) -> tuple[StoredRun, list[Event]]:
    """A run with its first models only."""
    run, events = create_run(folder, BRIEF), list[Event]()
    initial_progress(
        Training(run, events.append, lambda message: nullcontext(), purse=Purse(limits))
    )
    return run, events


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredRun, list[Event]]:
    """A run that was not interrupted."""
    return explored(tmp_path_factory.mktemp("begun") / "run")


def test_the_first_data_are_counted_and_told(begun: tuple[StoredRun, list[Event]]) -> None:
    run, (asked, fitted) = begun
    assert isinstance(asked, WorldAsked)
    assert isinstance(fitted, ModelsFitted)
    assert (asked.stage, asked.phase, fitted.stage) == ("start", EXPLORATION, "start")
    assert asked_at_start(run.folder) == {EXPLORATION: vars(asked.asked)}
    known = load_progress(run, run.folder / "start").knowledge
    assert len(known.dataset.succeeded) + len(known.aside.succeeded) == asked.asked.tests > 0
    carried_out = len(known.dataset.percept) + len(known.aside.percept)
    assert 0 < carried_out <= asked.asked.motions <= BRIEF.transitions + 1
    assert asked.asked.episodes == 0 < asked.asked.looks


def test_without_labels_c_is_not_tested_in_the_world(begun: tuple[StoredRun, list[Event]]) -> None:
    _, events = begun
    assert isinstance(events[1], ModelsFitted)
    assert "fresh" not in events[1].summary.text


def test_what_is_known_is_not_explored_again(begun: tuple[StoredRun, list[Event]]) -> None:
    run, events = begun
    again: list[Event] = []
    training = Training(read_run(run.folder), again.append, lambda message: nullcontext())
    recall_spent(training)
    initial_progress(training)
    assert again == []
    assert isinstance(events[0], WorldAsked)
    assert training.purse.spent == {EXPLORATION: events[0].asked}


def ends_at(motion: int) -> Callable[..., Any]:
    """`Recording.step` in a program that ends at the n-th motion, which is paid for by then."""
    step, count = Recording.step, itertools.count(1)

    def ends(self: Recording, *given: Any) -> Any:
        if next(count) == motion:
            self.purse.pay(self.phase, Asked(motions=1))
            raise KeyboardInterrupt
        return step(self, *given)

    return ends


@pytest.mark.parametrize("motion", [1, 8])
def test_an_exploration_that_is_killed_is_made_again_and_counted_once(
    begun: tuple[StoredRun, list[Event]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    motion: int,
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "step", ends_at(motion))
        with pytest.raises(KeyboardInterrupt):
            explored(tmp_path / "run")
    run = read_run(tmp_path / "run")
    assert not (run.folder / "start").exists()
    training = training_of(run)
    recall_spent(training)
    initial_progress(training)
    first, path = begun[0].folder, "start/data.safetensors"
    assert (run.folder / path).read_bytes() == (first / path).read_bytes()
    assert asked_at_start(run.folder) == asked_at_start(first)


def test_a_budget_that_does_not_cover_the_first_data_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(BudgetSpentError, match="budget of 3 motions is spent; raise it"):
        explored(tmp_path / "run", motions=3)
    assert not (tmp_path / "run" / "start").exists()


def test_in_a_world_that_does_not_repeat_itself_one_robot_explores(tmp_path: Path) -> None:
    """No two are side by side in it, and nothing is asked of it only for a report."""
    own = TabletopSettings(noise="fresh")
    run, events = create_run(tmp_path / "run", SMALL, own), list[Event]()
    assert not run.repeats
    assert not read_run(run.folder).repeats
    initial_progress(Training(run, events.append, lambda message: nullcontext()))
    asked, fitted = events
    assert isinstance(asked, WorldAsked)
    assert isinstance(fitted, ModelsFitted)
    assert asked.asked.looks == -(-asked.asked.motions // 6)  # a fresh start after six motions
    assert "fresh" not in fitted.summary.text
    seen = load_progress(run, run.folder / "start").knowledge.dataset.percept
    assert len(torch.unique(seen, dim=0)) == len(seen)
