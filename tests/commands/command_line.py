"""Running the commands in this process, as a shell would."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from cgtorch.commands import evaluate as evaluate_command
from cgtorch.commands import export as export_command
from cgtorch.commands import report as report_command
from cgtorch.commands import robot as robot_command
from cgtorch.commands import train as train_command
from cgtorch.commands import view as view_command
from cgtorch.domains.settings import to_plain
from cgtorch.runs.settings import RunSettings

MAIN: dict[str, Callable[[], None]] = {
    "cgtorch-train": train_command.main,
    "cgtorch-evaluate": evaluate_command.main,
    "cgtorch-export": export_command.main,
    "cgtorch-report": report_command.main,
    "cgtorch-robot": robot_command.main,
    "cgtorch-view": view_command.main,
}


def as_options(settings: RunSettings) -> list[str]:
    """Settings as words for `cgtorch-train`, without a user's actions, data and driver."""
    values = to_plain(settings)
    others = ("actions", "data", "driver")
    return [f"--{n.replace('_', '-')}={v}" for n, v in values.items() if n not in others]


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


class Shell:
    """Runs commands in an empty folder."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
        self.monkeypatch, self.capsys = monkeypatch, capsys

    def __call__(self, *words: object) -> Ended:
        arguments = [str(w) for w in words]
        self.monkeypatch.setattr(sys, "argv", arguments)
        self.monkeypatch.setattr(sys, "path", list(sys.path))
        self.capsys.readouterr()
        try:
            MAIN[arguments[0]]()
            code = 0
        except SystemExit as e:
            code = int(e.code or 0)
        captured = self.capsys.readouterr()
        return Ended(code, captured.out, captured.err)

    def refuses(self, *words: object) -> str:
        """The one line that a command with bad input ends in."""
        ended = self(*words)
        assert ended.code == 2, ended
        assert ended.out == ""
        assert ended.err.count("\n") == 1, ended.err
        assert ended.err.startswith(f"{words[0]}: ")
        assert "Traceback" not in ended.err
        return ended.err


def listing(folder: Path) -> set[str]:
    """Everything in a folder, hidden files too."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def in_a_shell(
    *words: str, folder: Path | None = None, before: Callable[[], None] | None = None
) -> Ended:
    """Run the installed command in a process of its own; `before` runs in it first."""
    ended = subprocess.run(
        [str(Path(sys.executable).with_name(words[0])), *words[1:]],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        preexec_fn=before,
        capture_output=True,
        text=True,
        check=False,
    )
    return Ended(ended.returncode, ended.stdout, ended.stderr)
