"""What a run begins with: data from files, of large ones a part, and what it explores."""

import itertools
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import driven_cart
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rewarded_cart import RewardedCart
from support import create_run, seeded
from told_by_runs import asked_at_start
from trained import SMALL

from cgtorch import write_data
from cgtorch.domains.exploration import EXPLORATION
from cgtorch.domains.live import OnRobot
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.ground.environment import Dataset, start_lanes
from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.improvement.events import Event, ModelsFitted, WorldAsked
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, planned_run, read_run
from cgtorch.simulation import Recording
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training import start as module
from cgtorch.training.context import Training
from cgtorch.training.start import given_data, initial_progress, known_at_last, recall_spent


def some_data(moves: int, met: int, missed: int) -> Dataset:
    """Data whose first numbers tell their rows."""
    p = torch.arange(moves).float()[:, None].repeat(1, 2)
    tested = torch.arange(met + missed).float()[:, None].repeat(1, 2)
    return Dataset(p, p[:, :1] / 1e6, p, tested, torch.arange(met + missed) < met)


def run_with(folder: Path, data: Dataset, **settings: object) -> StoredRun:
    """A run of carts that is given these data."""
    path = folder / "log.csv"
    run = planned_run(
        folder / "run",
        RunSettings(**{"domain": "examples.cart:Cart", "data": (str(path),), **settings}),
    )
    write_data(path, data, run.domain.percept, run.domain.control)
    return run


def same(one: Dataset, other: Dataset) -> bool:
    return all(torch.equal(a, b) for a, b in zip(astuple(one), astuple(other), strict=True))


def test_small_files_are_taken_as_they_are(tmp_path: Path) -> None:
    data = some_data(40, 7, 30)
    assert same(given_data(run_with(tmp_path, data)), data)


def test_of_large_files_a_random_part_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_TRANSITIONS", 20)
    monkeypatch.setattr(module, "MOST_LABELS", 30)
    data = some_data(100, 200, 300)
    found = given_data(run_with(tmp_path, data))
    assert len(found.percept) == 20
    assert len(found.tested) == 30
    assert int(found.succeeded.sum()) == 15
    for rows in (found.percept[:, 0], found.tested[:, 0]):
        assert (rows.diff() > 0).all()  # in their order, and no row twice
    assert same(found, given_data(run_with(tmp_path, data)))
    other = given_data(run_with(tmp_path, data, seed=1))
    assert not torch.equal(found.percept, other.percept)


@pytest.mark.parametrize(("met", "missed"), [(4, 200), (200, 4)])
def test_rare_results_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, met: int, missed: int
) -> None:
    monkeypatch.setattr(module, "MOST_LABELS", 30)
    found = given_data(run_with(tmp_path, some_data(20, met, missed)))
    met_found = int(found.succeeded.sum())
    assert sorted([met_found, len(found.tested) - met_found]) == [4, 26]


@pytest.fixture(scope="module")
def planned() -> StoredRun:
    settings = RunSettings(domain="examples.cart:Cart", data=("log.csv",))
    return planned_run(Path("none"), settings)


@given(st.integers(0, 30), st.integers(0, 30), st.integers(2, 20))
def test_as_many_tests_as_there_may_be(
    planned: StoredRun, met: int, missed: int, most: int
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_LABELS", most)
        data = some_data(3, met, missed)
        patch.setattr(module, "read_data", lambda *about: data)
        found = given_data(planned)
    assert len(found.tested) == min(most, met + missed)
    assert int(found.succeeded.sum()) >= min(met, most // 2)
    assert int((~found.succeeded).sum()) >= min(missed, most // 2)


def test_data_alone_have_to_be_enough(tmp_path: Path) -> None:
    few = some_data(9, 3, 3)
    assert same(given_data(run_with(tmp_path, few)), few)  # the run explores further
    with pytest.raises(DataError, match="the data have 9 transitions"):
        given_data(run_with(tmp_path, few, transitions=0))
    with pytest.raises(SettingsError, match="Γ and C are learned from data"):
        given_data(run_with(tmp_path, few, models="none"))


def test_what_an_exploration_did_not_consider_is_known_too() -> None:
    one, more = some_data(4, 2, 3), some_data(2, 1, 1)
    assert known_at_last(None, more) is more
    assert same(known_at_last(one, one.extended(more)), one.extended(more))
    assert same(known_at_last(one, more), one.extended(more))
    assert same(known_at_last(one, one), one)
    other = replace(one, control=one.control + 1)  # of the same percepts
    assert same(known_at_last(one, other), one.extended(other))


def begin(run: StoredRun, events: list[Event], purse: Purse | None = None) -> Training:
    """What a training does first: it recalls what was asked, and gets its first models."""
    known = purse or Purse()
    training = Training(run, events.append, lambda message: nullcontext(), purse=known)
    recall_spent(training)
    initial_progress(training)
    return training


def explored(folder: Path, **limits: float) -> tuple[StoredRun, list[Event]]:
    """A run with its first models only."""
    run, events = create_run(folder, SMALL), list[Event]()
    begin(run, events, Purse(limits))
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
    assert 0 < carried_out <= asked.asked.motions <= SMALL.transitions + 1
    assert asked.asked.episodes == 0 < asked.asked.looks
    assert "fresh" not in fitted.summary.text  # without labels C is not tested in the world


def test_what_is_known_is_not_explored_again(begun: tuple[StoredRun, list[Event]]) -> None:
    run, events = begun
    again: list[Event] = []
    training = begin(read_run(run.folder), again)
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
    begin(run, [])
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
    begin(run, events)
    asked, fitted = events
    assert isinstance(asked, WorldAsked)
    assert isinstance(fitted, ModelsFitted)
    assert asked.asked.looks == -(-asked.asked.motions // 6)  # a fresh start after six motions
    assert "fresh" not in fitted.summary.text
    seen = load_progress(run, run.folder / "start").knowledge.dataset.percept
    assert len(torch.unique(seen, dim=0)) == len(seen)


def test_with_data_alone_nothing_is_asked_of_the_world(tmp_path: Path) -> None:
    data = some_data(400, 60, 60)
    run = run_with(tmp_path, data, transitions=0)
    training = Training(run, lambda event: None, lambda message: nullcontext())
    assert same(module._first_data(training, seeded(0)), data)
    assert training.purse.total == Asked()


def test_what_a_robot_explored_before_an_interruption_is_known_and_paid_for(tmp_path: Path) -> None:
    domain = driven_cart.cart(tmp_path / "log")
    run = StoredRun(tmp_path / "run", RunSettings(), domain, domain.actions())
    training = Training(run, lambda event: None, lambda message: nullcontext())
    assert module._explored(training) is None
    world, lanes = driven_cart.begun(domain, phase=EXPLORATION, stage="start")
    world.step(lanes, driven_cart.push(0.5))
    later = driven_cart.cart(tmp_path / "log")
    again = replace(training, run=replace(run, domain=later))
    data = module._explored(again)
    assert data is not None
    assert data.control.tolist() == [[0.5]]
    assert again.purse.spent[EXPLORATION].motions == 1
    table = create_run(tmp_path / "table", RunSettings())  # which can be put back
    assert module._explored(replace(training, run=table)) is None


@pytest.mark.parametrize("live", [True, False])
def test_a_robot_is_explored_as_one(live: bool, tmp_path: Path) -> None:
    domain = driven_cart.cart(tmp_path / "log") if live else RewardedCart()
    run = StoredRun(tmp_path / "run", RunSettings(transitions=70), domain, domain.actions())
    training = Training(run, lambda event: None, lambda message: nullcontext())
    known = some_data(3, 1, 1)
    found = module._exploration(training, seeded(0), known)
    assert (found.live, found.most, found.known) == (live, 70, known)
    assert found.purse is training.purse
    assert found.lanes == (module.LANES if run.repeats else 1)
    world: Any = found.worlds(run.kind, 1)
    lanes = start_lanes(world, torch.arange(1), 4, 4)
    world.step(lanes, torch.full((1, len(domain.control)), 0.25))
    assert training.purse.spent[EXPLORATION].motions == 1
    if isinstance(domain, OnRobot):  # another training knows of it
        again = driven_cart.cart(tmp_path / "log")
        assert again.actor.explored(2, 1)[0].control.tolist() == [[0.25]]


@pytest.mark.parametrize("transitions", [0, 30])
def test_data_alone_are_read_and_other_data_are_where_an_exploration_begins(
    transitions: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, said = some_data(400, 60, 60), list[str]()
    run = run_with(tmp_path, data, transitions=transitions)
    begun = list[Any]()

    def explored(exploration: Any) -> Dataset:
        begun.append(exploration)
        return data

    monkeypatch.setattr(type(run.models), "explore", lambda models, about: explored(about))

    def working(message: str) -> nullcontext[None]:
        said.append(message)
        return nullcontext()

    found = module._first_data(Training(run, lambda event: None, working), seeded(0))
    assert same(found, data)
    if transitions:
        (exploration,) = begun
        assert (exploration.most, same(exploration.known, data)) == (transitions, True)
        assert said == ["exploring: motions that teach the models most"]
    else:
        assert (said, begun) == (["reading the data"], [])
