"""`cgtorch-train --resume RUN`: to what it was begun for, or under settings that are taken over."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import TRAIN, Shell, about, edited
from told_by_runs import logged
from torch import Tensor
from trained import SMALL, Trained, begin_last, copied, first_evolution, interrupted

from cgtorch.domains.settings import to_plain
from cgtorch.runs.stored_run import read_run, versions

GOAL = {"target": 0.999, "minutes": 10.0, "rounds": 1}


def test_to_the_stage_it_was_begun_for(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "run")
    assert "goes_on_to" not in about(folder)
    for stage in ("S1", "S0"):
        for words in (["--stage", stage], []):
            said = shell.does(TRAIN, "--resume", folder, *words).said
            assert f"run {folder} is complete up to {stage}" in said
            assert about(folder)["goes_on_to"] == {"stage": stage}


def test_to_the_usual_stage_where_nothing_was_asked_for(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    assert f"run {folder} is complete up to S2" in shell.does(TRAIN, "--resume", folder).said
    assert about(folder)["goes_on_to"] == {"stage": "S2"}


def test_a_run_without_its_data_is_refused_before_anything_is_written(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    shutil.rmtree(folder / "start")
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    line = shell.refuses(TRAIN, "--resume", folder, "--stage", "S1")
    assert "is stored without its data and models" in line
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


@pytest.mark.parametrize(
    ("begun_for", "words", "says"),
    [
        ({"stage": "S1"}, ["--stage", "S9"], "unknown stage 'S9'"),
        ({"stage": "S1"}, ["--stage", "S1", "--target", 0.9], "rounds are for stage 'auto'"),
        ({"stage": "S1"}, ["--target", 0.9], "rounds are for stage 'auto'"),
        ({"stage": "S1"}, ["--stage", "auto", "--target", 7], "target is 7, which is no share"),
        ({"stage": "S1"}, ["--stage", "auto", "--seed", 1], f"has seed {SMALL.seed}, not 1"),
        # What is damaged is refused, too.
        (3, [], "goes_on_to of"),
        ([], [], "goes_on_to of"),
        ({"stage": 3}, [], "unknown stage '3'"),
        ({"stage": "../S0"}, [], "unknown stage '../S0'"),
        ({"stage": "auto", "goal": {"colour": 1}}, [], "is damaged"),
        ({"stage": "auto", "goal": {"target": "much"}}, [], "target is 'much'; give a number"),
        ({"stage": "auto", "goal": {"rounds": 1e9}}, [], "rounds is 1000000000.0; give a whole"),
        ({"stage": "auto", "goal": {"minutes": 10**400}}, [], "minutes is 1000"),
    ],
)
def test_what_is_refused_is_not_remembered(
    shell: Shell,
    trained: Trained,
    tmp_path: Path,
    begun_for: object,
    words: list[object],
    says: str,
) -> None:
    folder = copied(trained, tmp_path / "run")
    edited(folder, goes_on_to=begun_for)
    assert says in shell.refuses(TRAIN, "--resume", folder, *words)
    assert about(folder)["goes_on_to"] == begun_for


def same(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    return one.keys() == other.keys() and all(one[name].equal(other[name]) for name in one)


@pytest.mark.hostile
def test_a_stage_in_the_middle_is_made_again_under_what_was_taken_over(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    """It goes on as if it had been begun so, and what it had come to is not lost."""
    folder = interrupted(trained, tmp_path / "run").folder
    half = {p.name: p.read_bytes() for p in (folder / "journal" / "S1").iterdir()}
    words = [TRAIN, "--resume", folder, "--stage", "S0", "--population", 30]
    assert "population=30" in shell.refuses(*words, "--quiet")
    assert {p.name: p.read_bytes() for p in (folder / "journal" / "S1").iterdir()} == half
    words += ["--override", "population=30", "--override", "max-transitions=15"]
    said = shell.does(*words).said
    assert "population is 30 instead of 60; S1 begins again" in said
    assert "max_transitions is 15 instead of 20; S1 begins again" in said
    assert f"the unfinished work on S1 is in {folder / 'set-aside' / '1'}" in said
    assert {p.name: p.read_bytes() for p in (folder / "set-aside/1/S1").iterdir()} == half

    settings = replace(SMALL, population=30, max_transitions=15)
    assert read_run(folder).settings == settings
    changed = {"population": [60, 30], "max_transitions": [20, 15]}
    entry = {"stage": "S1", "changed": changed, "set_aside": "set-aside/1"}
    (row,) = logged(folder, "changed")
    assert row == row | entry
    wanted = copied(trained, tmp_path / "wanted", ("S0",))
    edited(wanted, to_plain(settings))
    found = begin_last(read_run(folder))
    assert same(found, begin_last(read_run(wanted)))
    assert not same(found, first_evolution(folder / "set-aside" / "1"))
    # Said again, as under torchrun's restarts, it changes nothing more.
    assert "instead of" not in shell.does(*words).err
    assert logged(folder, "changed") == [row]
    assert same(begin_last(read_run(folder)), found)


@pytest.mark.parametrize(
    ("name", "again"), [("cgtorch", True), ("torch", False), ("engine", False)]
)
def test_another_version_is_said_once_and_another_cgtorch_begins_the_stage_again(
    name: str, again: bool, shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run", ("S0",))
    (folder / "journal" / "S1").mkdir(parents=True)
    (folder / "journal" / "S1" / "1-evolution.safetensors").touch()
    edited(folder, **{name: "0.0.1"})
    words = [TRAIN, "--resume", folder, "--stage", "S0"]
    said = shell.does(*words).said
    assert f"was made with {name} 0.0.1 so far, this is {name} " in said
    assert ("S1 begins again" in said) == again
    assert (folder / "set-aside" / "1" / "S1").exists() == again
    assert (folder / "journal" / "S1").exists() == (not again)
    version = versions()[name]
    assert about(folder)[name] == version
    (row,) = logged(folder, "changed")
    assert row["changed"] == {name: ["0.0.1", version]}
    assert "was made with" not in shell.does(*words).err
    assert logged(folder, "changed") == [row]
