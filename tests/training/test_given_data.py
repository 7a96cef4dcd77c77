"""What a run learns from files: all of small ones, a part of large ones, and never less."""

from dataclasses import astuple
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch import write_data
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, planned_run
from cgtorch.training import start as module
from cgtorch.training.start import given_data, known_at_last


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


@given(st.integers(0, 30), st.integers(0, 30), st.integers(2, 20))
def test_as_many_tests_as_there_may_be(met: int, missed: int, most: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_LABELS", most)
        data = some_data(3, met, missed)
        patch.setattr(module, "read_data", lambda *about: data)
        settings = RunSettings(domain="examples.cart:Cart", data=("log.csv",))
        found = given_data(planned_run(Path("none"), settings))
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
