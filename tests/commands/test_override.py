"""`cgtorch-train --resume RUN --override NAME=VALUE`, and runs of another version."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import Shell
from told_by_runs import logged
from torch import Tensor
from trained import SMALL, Trained, begin_last, copied, first_evolution, interrupted

from cgtorch.domains.settings import to_plain
from cgtorch.runs.stored_run import read_run, versions

TRAIN = "cgtorch-train"


def about(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "run.json").read_text())
    return found


def edited(folder: Path, **values: Any) -> None:
    (folder / "run.json").write_text(json.dumps({**about(folder), **values}))


def same(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    return one.keys() == other.keys() and all(one[name].equal(other[name]) for name in one)


def test_a_stage_in_the_middle_is_made_again_under_what_was_taken_over(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    """It goes on as if it had been begun so, and what it had come to is not lost."""
    folder = interrupted(trained, tmp_path / "run").folder
    half = {p.name: p.read_bytes() for p in (folder / "journal" / "S1").iterdir()}
    words = ["--resume", folder, "--stage", "S0", "--population", 30]
    assert "population=30" in shell.refuses(TRAIN, *words, "--quiet")
    assert {p.name: p.read_bytes() for p in (folder / "journal" / "S1").iterdir()} == half
    words += ["--override", "population=30", "--override", "max-transitions=15"]
    ended = shell(TRAIN, *words)
    said = " ".join(ended.err.split())
    assert ended.code == 0, ended
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
    edited(wanted, settings=to_plain(settings))
    found = begin_last(read_run(folder))
    assert same(found, begin_last(read_run(wanted)))
    assert not same(found, first_evolution(folder / "set-aside" / "1"))
    # Said again, as under torchrun's restarts, it changes nothing more.
    ended = shell(TRAIN, *words)
    assert ended.code == 0, ended
    assert "instead of" not in ended.err
    assert logged(folder, "changed") == [row]
    assert same(begin_last(read_run(folder)), found)


@pytest.mark.parametrize(
    ("name", "again"), [("cgtorch", True), ("torch", False), ("engine", False)]
)
def test_another_version_is_said_once_and_another_cgtorch_begins_the_stage_again(
    name: str, again: bool, shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    run = interrupted(trained, tmp_path / "run")
    edited(run.folder, **{name: "0.0.1"})
    words = ["--resume", run.folder, "--stage", "S0"]
    ended = shell(TRAIN, *words)
    assert ended.code == 0, ended
    said = " ".join(ended.err.split())
    assert f"was made with {name} 0.0.1 so far, this is {name} " in said
    assert ("S1 begins again" in said) == again
    assert (run.folder / "set-aside" / "1" / "S1").exists() == again
    assert (run.folder / "journal" / "S1").exists() == (not again)
    version = versions()[name]
    assert about(run.folder)[name] == version
    (row,) = logged(run.folder, "changed")
    assert row["changed"] == {name: ["0.0.1", version]}
    assert "was made with" not in shell(TRAIN, *words).err
    assert logged(run.folder, "changed") == [row]
