"""The parts that the page is made of, one by one."""

import shlex
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from report_pages import thinned
from support import create_run

from cgtorch.commands.train import command
from cgtorch.report.reproduce import changes_of, training_commands
from cgtorch.runs.log import Row
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.tabletop.settings import TabletopSettings

SLOW = "CGTORCH_NATIVE=0"


def options(line: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """All options that a command line gives, and the settings among them."""
    words = [word for word in shlex.split(line) if word != SLOW]
    assert words[0] == "cgtorch-train"
    values = command.make_context("cgtorch-train", words[1:]).params
    names = {f.name for kind in (RunSettings, TabletopSettings) for f in fields(kind)}
    found = {name: value for name, value in values.items() if name in names}
    return values, {**found, "driver": found["driver"] or ""}


@pytest.mark.parametrize(
    ("settings", "own"),
    [
        (RunSettings(), TabletopSettings()),
        (
            RunSettings(seed=7, population=60, method="paper"),
            TabletopSettings(position_noise=0.01, networks="percept"),
        ),
        (
            RunSettings(scenarios="general", islands=3, migration=2),
            TabletopSettings(heading_noise=0.0),
        ),
        (RunSettings(practice=24), TabletopSettings(noise="fresh")),
        (
            RunSettings(transitions=0, data=("logs/one day.csv", "two.parquet")),
            TabletopSettings(),
        ),
    ],
)
def test_the_command_gives_the_settings(
    tmp_path: Path, settings: RunSettings, own: TabletopSettings
) -> None:
    run = create_run(tmp_path / "run", settings, own)
    (line,) = training_commands(run, {}, [])
    found = options(line)[1]
    theirs = {f.name: found.pop(f.name) for f in fields(own)}
    assert RunSettings(**found) == settings
    assert TabletopSettings(**theirs) == own


def change(stage: str, **values: list[Any]) -> Row:
    return {"event": "changed", "stage": stage, "changed": values}


def ended(**goal: Any) -> Row:
    return {"event": "ended", "stage": "auto", **goal}


def with_stages(folder: Path, *names: str) -> StoredRun:
    for name in names:
        (folder / name).mkdir()
        (folder / name / "skill.json").write_text("{}")
    return read_run(folder)


def test_what_was_taken_over_is_taken_over_again(tmp_path: Path) -> None:
    create_run(tmp_path / "my run", RunSettings(population=700, attempts=5))
    run = with_stages(tmp_path / "my run", "S0", "S1", "S2", "auto-1", "auto-2", "auto-3")
    log = [
        change("S1", population=[400, 600], torch=["2.4", "2.5"]),
        change("S1", population=[600, 650]),
        change("auto-1", engine=["torch", "compiled"]),
        change("auto-3", population=[650, 700], attempts=[24, 5]),
        ended(target=0.9, rounds=30, minutes=4.0),
    ]
    lines = training_commands(run, {"engine": "compiled"}, log)
    found = [options(line)[0] for line in lines]
    assert [(f["stage"], f["resume"] is None) for f in found] == [
        ("S0", True), ("S2", False), ("auto", False), ("auto", False),
    ]  # fmt: skip
    assert [line.startswith(SLOW) for line in lines] == [True, True, False, False]
    assert (found[0]["population"], found[0]["attempts"]) == (400, 24)
    assert found[1]["override"] == ("population=600", "population=650")
    assert [f["override"] for f in found[2:]] == [(), ("population=700", "attempts=5")]
    assert [(f["rounds"], f["target"]) for f in found[2:]] == [(2, 0.9), (3, 0.9)]
    assert changes_of(log)[1] == ("S1", "torch", "2.4", "2.5")


@pytest.mark.parametrize(
    ("goal", "words", "last"),
    [
        ({"target": 0.99, "minutes": 10.0, "rounds": 3}, "auto --rounds 2", True),
        ({"target": 0.9, "minutes": 10.0, "reached": False}, "auto --target 0.9 --rounds 2", True),
        ({"target": 0.99, "reached": True}, "auto", True),
        ({"target": 0.99, "reached": True}, "auto --rounds 2", False),
    ],
)
def test_of_a_goal_is_said_what_nobody_knows(
    tmp_path: Path, goal: dict[str, Any], words: str, last: bool
) -> None:
    """A run that has reached its goal ends after as many rounds by itself."""
    create_run(tmp_path / "run", RunSettings())
    run = with_stages(tmp_path / "run", "auto-1", "auto-2")
    later = [] if last else [{"event": "stage", "stage": "auto-3"}]
    (line,) = training_commands(run, {}, [ended(**goal), *later])
    assert line.partition(" --seed")[0] == f"cgtorch-train --stage {words}"


def test_settings_that_changed_within_the_first_stage_are_those_it_begins_with(
    tmp_path: Path,
) -> None:
    """The stage begins again when they change, so nothing of the earlier ones is left."""
    create_run(tmp_path / "run", RunSettings(population=500))
    run = with_stages(tmp_path / "run", "auto-1", "auto-2")
    entries = [("auto-1", [400, 500]), ("auto-2", [500, 700])]
    for count in (1, 2):
        log = [change(stage, population=values) for stage, values in entries[:count]]
        line = training_commands(run, {}, log)[0]
        assert "--population 500" in line
        assert "400" not in line


def test_another_robot_and_actions_are_named(tmp_path: Path) -> None:
    folder = thinned(tmp_path / "it's", "S0", models=False)
    path = folder / "robot" / "robot.json"
    path.write_text(path.read_text() + "\n")
    (line,) = training_commands(read_run(folder), {}, {})
    values, _ = options(line)
    assert str(values["urdf"]) == "it's/robot/robot.urdf"
    assert str(values["robot"]) == "it's/robot/robot.json"
