"""Going on under changed settings or with another version: nothing mixes, all is remembered."""

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from told_by_runs import logged
from trained import SMALL, Trained, interrupted

from cgtorch.ground.errors import SettingsError
from cgtorch.runs.changes import fixed_settings, overridden, refuse_others
from cgtorch.runs.journal import FileJournal, take_over
from cgtorch.runs.stored_run import read_run


def about(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "run.json").read_text())
    return found


def test_settings_that_decided_on_what_is_there_are_fixed(trained: Trained) -> None:
    run = read_run(trained.folder)
    fixed, known = fixed_settings(run), {**vars(run.settings), **vars(run.domain.settings)}
    assert set(fixed) == {
        *("domain", "seed", "method", "models", "transitions", "scenarios", "actions"),
        *("data", "driver"),
        *("robot", "urdf", "position_noise", "heading_noise", "noise", "percept", "networks"),
        *("world", "touch", "grasp"),
    }
    for name, reason in fixed.items():
        other = (known[name], "x")
        with pytest.raises(SettingsError, match=f"{name} .* as {reason}"):
            overridden(run, {name: other})
        with pytest.raises(SettingsError, match=f"as {reason}; leave it out"):
            refuse_others(run, {name: other}, "leave it out")
        assert overridden(run, {name: known[name]}) == run.settings
    refuse_others(run, known, "leave it out")
    refuse_others(run, run.all_settings(), "leave it out")


def test_the_history_grows_and_a_journal_goes_aside_each_time(
    trained: Trained, tmp_path: Path
) -> None:
    run = interrupted(trained, tmp_path / "run")
    for number in (1, 2):
        FileJournal(run.folder / "journal" / "S1").record("x", {"x": torch.tensor(number)})
        settings = overridden(run, {"attempts": run.settings.attempts + 1})
        taken = take_over(run, settings, "S1")
        assert (taken.before, taken.set_aside) == ("S1", f"set-aside/{number}")
        assert not (run.folder / "journal").exists()
        run = taken.run
        assert run == replace(read_run(run.folder), domain=run.domain, actions=run.actions)
    taken = take_over(run, overridden(run, {"islands": 3}), "auto")
    assert (taken.before, taken.set_aside) == ("auto-1", None)
    changes = [row["changed"] for row in logged(run.folder, "changed")]
    first = SMALL.attempts
    assert changes == [
        {"attempts": [first, first + 1]},
        {"attempts": [first + 1, first + 2]},
        {"islands": [1, 3]},
    ]


def test_what_stops_it_in_between_leaves_a_run_of_the_old_settings(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = interrupted(trained, tmp_path / "run")
    before = about(run.folder)

    def fails(*words: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cgtorch.runs.journal.write_json", fails)
    with suppress(KeyboardInterrupt):
        take_over(run, overridden(run, {"population": 30}), "S1")
    assert about(run.folder) == before
    assert not (run.folder / "journal").exists()  # so nothing of two kinds can meet
    monkeypatch.undo()
    taken = take_over(run, overridden(run, {"population": 30}), "S1")
    assert taken.set_aside is None
    (row,) = logged(run.folder, "changed")  # written once, before all else
    assert (row["stage"], row["changed"]) == ("S1", {"population": [60, 30]})
    assert row["set_aside"] == "set-aside/1"
    assert read_run(run.folder).settings.population == 30
