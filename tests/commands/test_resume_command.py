"""`cgtorch-train --resume RUN` alone goes on to what the run was begun for."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import Shell
from told_by_runs import logged
from trained import SMALL, Trained, copied

TRAIN = "cgtorch-train"
GOAL = {"target": 0.999, "minutes": 10.0, "rounds": 1}


def about(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "run.json").read_text())
    return found


def edited(folder: Path, goes_on_to: object = None, **settings: Any) -> None:
    """Write what a run was begun for, and other settings."""
    data = about(folder)
    more = {} if goes_on_to is None else {"goes_on_to": goes_on_to}
    text = json.dumps({**data, **more, "settings": {**data["settings"], **settings}})
    (folder / "run.json").write_text(text)


def said(shell: Shell, *words: object) -> str:
    """What a training says, in one line."""
    ended = shell(TRAIN, *words)
    assert ended.code == 0, ended
    return " ".join(ended.err.split())


def test_to_the_stage_it_was_begun_for(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "run")
    assert "goes_on_to" not in about(folder)
    assert f"run {folder} is complete up to S1" in said(shell, "--resume", folder, "--stage", "S1")
    assert about(folder)["goes_on_to"] == {"stage": "S1"}
    assert f"run {folder} is complete up to S1" in said(shell, "--resume", folder)
    assert f"run {folder} is complete up to S0" in said(shell, "--resume", folder, "--stage", "S0")
    assert about(folder)["goes_on_to"] == {"stage": "S0"}
    assert f"run {folder} is complete up to S0" in said(shell, "--resume", folder)


def test_what_it_lacks_is_made(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "run", ("S0",))
    edited(folder, {"stage": "S1"})
    assert f"run {folder} is complete up to S1" in said(shell, "--resume", folder)
    made = (folder / "S1" / "skill.json").read_bytes()
    assert made == (trained.folder / "S1" / "skill.json").read_bytes()


def test_to_the_domains_usual_stage_where_nothing_was_asked_for(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    assert f"run {folder} is complete up to S2" in said(shell, "--resume", folder)
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


def test_to_the_goal_it_was_begun_for(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    """What is given anew is another goal from then on, and the rest of the goal stays."""
    folder = copied(trained, tmp_path / "run")
    edited(folder, attempts=1)
    words = ["--resume", folder]
    goal = ["--stage", "auto", "--target", 0.999, "--rounds", 1]
    assert "has not reached its goal of 0.999" in said(shell, *words, *goal)
    assert about(folder)["goes_on_to"] == {"stage": "auto", "goal": GOAL}
    assert "has not reached its goal of 0.999" in said(shell, *words)
    assert not (folder / "auto-2").exists()
    assert "has not reached its goal of 0.999" in said(shell, *words, "--minutes", 0)
    assert about(folder)["goes_on_to"] == {"stage": "auto", "goal": {**GOAL, "minutes": 0}}
    said(shell, *words, "--target", 0.5, "--minutes", 9)
    assert about(folder)["goes_on_to"]["goal"] == {"target": 0.5, "minutes": 9, "rounds": 1}
    ended = logged(folder, "ended")[-1]
    assert (ended["target"], ended["rounds"]) == (0.5, 1)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--stage", "S9"], "unknown stage 'S9'"),
        (["--stage", "S1", "--target", 0.9], "rounds are for stage 'auto'"),
        (["--target", 0.9], "rounds are for stage 'auto'"),
        (["--stage", "auto", "--target", 7], "target is 7.0"),
        (["--stage", "auto", "--seed", 1], f"has seed {SMALL.seed}, not 1"),
    ],
)
def test_what_is_refused_is_not_remembered(
    shell: Shell, trained: Trained, tmp_path: Path, words: list[object], says: str
) -> None:
    folder = copied(trained, tmp_path / "run")
    edited(folder, {"stage": "S1"})
    assert says in shell.refuses(TRAIN, "--resume", folder, *words)
    assert about(folder)["goes_on_to"] == {"stage": "S1"}


def test_a_run_with_rounds_remembers_no_stage(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    edited(folder, {"stage": "auto", "goal": GOAL})
    (folder / "S1").rename(folder / "auto-1")
    assert "cannot make a single stage any more" in shell.refuses(
        TRAIN, "--resume", folder, "--stage", "S2"
    )
    assert about(folder)["goes_on_to"] == {"stage": "auto", "goal": GOAL}


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (3, "goes_on_to of"),
        ([], "goes_on_to of"),
        ({"stage": 3}, "unknown stage '3'"),
        ({"stage": "../S0"}, "unknown stage '../S0'"),
        ({"stage": "auto", "goal": {"colour": 1}}, "is damaged"),
        ({"stage": "auto", "goal": {"target": "much"}}, "target is 'much'; give a number"),
        ({"stage": "auto", "goal": {"rounds": 1e9}}, "rounds is 1000000000.0; give a whole"),
        ({"stage": "auto", "goal": {"minutes": 10**400}}, "minutes is 1000"),
    ],
)
def test_a_damaged_wish(
    shell: Shell, trained: Trained, tmp_path: Path, value: object, says: str
) -> None:
    folder = copied(trained, tmp_path / "run")
    edited(folder, value)
    assert says in shell.refuses(TRAIN, "--resume", folder)
    assert about(folder)["goes_on_to"] == value
