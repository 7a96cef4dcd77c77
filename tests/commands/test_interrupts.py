"""An interrupt ends a command, also where a library's own code has dropped it."""

import os
import runpy
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click
import pytest

from cgtorch.commands import interrupts as module
from cgtorch.commands.common import run_command
from cgtorch.commands.interrupts import interrupts

LONG = 20.0  # s, which a command that is interrupted does not take


@pytest.fixture(autouse=True)
def _without_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["some"])


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.01)


class Ends:
    """Something whose end is when the signal comes."""


def in_an_end() -> None:
    thing = Ends()
    weakref.finalize(thing, interrupt)
    with suppress(BaseException):  # as pytest tells of what is raised there
        del thing


def in_a_library() -> None:
    with suppress(BaseException):
        interrupt()


def in_an_error_of_a_library() -> None:
    try:
        interrupt()
    except KeyboardInterrupt as e:
        raise ValueError("the answer is missing") from e


def ended(work: Callable[[], Any]) -> tuple[int, float]:
    """The exit code of a command, and the seconds that it took."""
    began = time.monotonic()
    with pytest.raises(SystemExit) as end:
        run_command(click.command("some")(work))
    return int(end.value.code or 0), time.monotonic() - began


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("drops", [in_an_end, in_a_library, in_an_error_of_a_library])
@pytest.mark.parametrize("goes_on", [True, False])
def test_a_command_is_interrupted_wherever_a_signal_comes(
    drops: Callable[[], None], goes_on: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> None:
        drops()
        until = time.monotonic() + LONG * goes_on
        while time.monotonic() < until:
            time.sleep(0.01)

    code, seconds = ended(work)
    assert (code, seconds < LONG / 2) == (1, True)
    assert capsys.readouterr().err.lstrip("\n") == "some: interrupted\n"  # click ends a ^C's line


def test_what_an_interrupt_makes_a_command_do_is_not_interrupted(tmp_path: Path) -> None:
    @contextmanager
    def kept() -> Any:
        try:
            yield
        finally:
            with suppress(ValueError):
                in_an_error_of_no_signal()
            time.sleep(1.5)
            (tmp_path / "kept").touch()

    def in_an_error_of_no_signal() -> None:
        raise ValueError

    def work() -> None:
        with kept():
            interrupt()

    assert ended(work)[0] == 1
    assert (tmp_path / "kept").exists()


def test_a_command_may_wait_for_an_interrupt() -> None:
    def work() -> None:
        with interrupts.awaited():
            interrupt()
        time.sleep(1.2)
        done.append(True)

    done = list[bool]()
    run_command(click.command("some")(work))
    assert done == [True]


def test_signals_mean_after_a_command_what_they_meant_before() -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    ended(interrupt)
    assert before == (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT))


def test_no_signal_comes_after_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, looked, came = threading.Event(), threading.Event(), list[int]()

    def look(thread: int) -> bool:
        looking.set()
        return not looked.wait(LONG)

    def work() -> None:
        with suppress(KeyboardInterrupt):
            interrupt()
        looking.wait(LONG)

    monkeypatch.setattr(module, "_interrupted", look)
    before = signal.signal(signal.SIGTERM, lambda number, frame: came.append(number))
    try:
        assert ended(work)[0] == 1
        looked.set()
        time.sleep(0.1)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert came == []


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [("/bin/cgtorch-view", 1, "cgtorch-view: interrupted\n"), ("own", 3, "")],
)
def test_a_command_that_still_imports_ends_in_a_line(name: str, code: int, said: str) -> None:
    program = (
        f"import os, signal, sys, time\nsys.argv = [{name!r}]\nimport cgtorch.commands\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(9)\n"
        "except KeyboardInterrupt:\n    sys.exit(3)"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (found.returncode, found.stderr) == (code, said)


def test_an_error_that_code_has_raised_is_not_taken_for_one_of_the_disk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own.py").write_text("def late():\n    raise TimeoutError('slow')\n")
    assert ended(runpy.run_path(str(tmp_path / "own.py"))["late"])[0] == 1
    assert capsys.readouterr().err.startswith("some: TimeoutError: slow in line 2 of ")
