"""Running the commands in this process, as a shell would."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from cgtorch.commands.common import run_command
from cgtorch.domains.settings import to_plain
from cgtorch.runs.settings import RunSettings

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "runs" / "reference"
TRAIN, EVALUATE, EXPORT, REPORT, ROBOT, VIEW = (
    f"cgtorch-{name}" for name in ("train", "evaluate", "export", "report", "robot", "view")
)


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

    @property
    def said(self) -> str:
        """What it said besides its results, in one line."""
        return " ".join(self.err.split())


class Shell:
    """Runs commands in an empty folder."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
        self.monkeypatch, self.capsys = monkeypatch, capsys

    def __call__(self, *words: object) -> Ended:
        name = str(words[0])
        self.monkeypatch.setattr(sys, "argv", [str(w) for w in words])
        self.monkeypatch.setattr(sys, "path", list(sys.path))
        self.capsys.readouterr()
        code = 0
        try:
            module = name.removeprefix("cgtorch-").replace("cgtorch", "main")
            run_command(import_module(f"cgtorch.commands.{module}").command)
        except SystemExit as e:
            code = int(e.code or 0)
        return Ended(code, *self.capsys.readouterr())

    def does(self, *words: object) -> Ended:
        """How a command ends that does what it should."""
        ended = self(*words)
        assert ended.code == 0, ended
        return ended

    def told(self, *words: object) -> Any:
        """What a command prints as JSON, and nothing else."""
        ended = self.does(*words, "--json")
        assert ended.err == ""
        return json.loads(ended.out)

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


def about(run: Path) -> dict[str, Any]:
    """What a run's file says."""
    found: dict[str, Any] = json.loads((run / "run.json").read_text())
    return found


def edited(run: Path, settings: Mapping[str, Any] | None = None, **values: Any) -> None:
    """Give a run's file other values, and other settings."""
    data = about(run)
    data["settings"] |= settings or {}
    (run / "run.json").write_text(json.dumps(data | values))


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


@lru_cache
def can_draw() -> bool:
    """Whether MuJoCo can draw on this machine, asked of MuJoCo alone."""
    code = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 9, 9)"
    return any(
        not subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "MUJOCO_GL": by}, capture_output=True
        ).returncode
        for by in ("egl", "osmesa")
    )
