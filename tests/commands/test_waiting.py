"""Long work on a terminal, elsewhere, and quiet; and how an interrupted command ends."""

import ctypes
import errno
import io
import re
import signal
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from functools import partial

import click
import pytest
from rich.console import Console

from cgtorch.commands.common import resumable, run_command, say, waiting
from cgtorch.ground.errors import SettingsError
from cgtorch.native.processes import counted
from cgtorch.report import progress


@pytest.mark.parametrize(
    ("terminal", "quiet", "shown"),
    [(True, False, True), (True, True, False), (False, False, False)],
)
def test_what_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, quiet: bool, shown: bool
) -> None:
    """One live line that goes away, or nothing at all, not even a control character."""
    written = io.StringIO()

    def console(stderr: bool) -> Console:
        assert stderr  # results go to the standard output
        return Console(file=written, force_terminal=terminal, width=90, legacy_windows=False)

    monkeypatch.setattr("rich.console.Console", console)
    with waiting("trying S3 [on] 40", quiet, 40) as done:
        more = counted("grasps in physics", 7)
        more(3)
        done(40)
        more(4)
    text = written.getvalue()
    for part in ("trying S3 [on] 40 …", "40/40", "grasps in physics"):
        assert (part in text) == shown
    assert (text == "") == (not shown)
    assert not shown or text.endswith("\x1b[2K")  # the line is cleared


def test_work_within_is_shown_as_far_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    console = partial(Console, file=written, force_terminal=True, width=90, legacy_windows=False)
    monkeypatch.setattr("rich.console.Console", lambda stderr: console())
    with waiting("trying", False, 40):
        counted("grasps", 7)(3)
    assert "3/7" in written.getvalue()
    assert "0/40" in written.getvalue()


@pytest.mark.parametrize("quiet", [False, True])
def test_without_a_terminal_a_line_tells_of_long_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    monkeypatch.setattr(progress, "SILENCE", 0.1)
    monkeypatch.setattr(progress, "LOOKED", 0.02)
    with waiting("fitting\x1b shapes", quiet, 40) as done:
        done(3)
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    said = r"fitting\\x1b shapes: 3 of 40(, .*/s, left .*)?, 0:00 elapsed"
    assert all(re.fullmatch(said, line) for line in lines)
    assert bool(lines) != quiet


def in_the_midst_of_ctypes() -> None:
    """An interrupt while ctypes converts an argument is another error."""

    class Converted:
        @classmethod
        def from_param(cls, value: object) -> object:
            raise KeyboardInterrupt

    function = ctypes.CDLL(None).abs
    function.argtypes = [Converted]
    function(1)


def swallowed_by_a_library() -> None:
    """An interrupt that a library turns into another error, of which another is made."""
    with suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    raise SettingsError("URDF is refused (unsupported operand); correct it")


@pytest.mark.parametrize(
    "happens",
    [
        lambda: signal.raise_signal(signal.SIGINT),
        swallowed_by_a_library,
        lambda: signal.raise_signal(signal.SIGTERM),
        lambda: signal.raise_signal(signal.SIGHUP),
        in_the_midst_of_ctypes,
    ],
)
@pytest.mark.parametrize(
    ("resumes", "line"),
    [
        (True, "stopped: interrupted; finished work is kept; continue with start --again\n"),
        (False, "stopped: interrupted\n"),
    ],
)
def test_an_interrupt(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    resumes: bool,
    line: str,
    happens: Callable[[], None],
) -> None:
    """Only work that can be continued is said to be."""

    def interrupted() -> None:
        with resumable("start --again") if resumes else nullcontext():
            happens()

    monkeypatch.setattr("sys.argv", ["stopped"])
    # Else they are ignored in the background, and with nohup.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    closed = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit) as ended:
            run_command(click.Command("stopped", None, interrupted))
    finally:
        signal.signal(signal.SIGINT, before)
        signal.signal(signal.SIGHUP, closed)
    assert ended.value.code == 1
    assert capsys.readouterr().err.lstrip("\n") == line  # click ends the line of a ^C


def test_a_closed_terminal_is_nothing_to_what_was_begun_with_nohup(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def closed() -> None:
        signal.raise_signal(signal.SIGHUP)
        click.echo("went on")

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        monkeypatch.setattr("sys.argv", ["begun"])
        run_command(click.Command("begun", None, closed))
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert capsys.readouterr().out == "went on\n"


@pytest.mark.parametrize("name", ["runs/one", b"runs/one"])
def test_a_path_is_told_as_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str | bytes
) -> None:
    def failed() -> None:
        with resumable("cgtorch-train --resume runs/one"):
            raise OSError(errno.EROFS, "Read-only file system", name)

    monkeypatch.setattr("sys.argv", ["stopped"])
    with pytest.raises(SystemExit):
        run_command(click.Command("stopped", None, failed))
    line = "stopped: cannot read or write 'runs/one' (Read-only file system); check the path"
    said = capsys.readouterr().err
    assert said.startswith(line)
    assert said.endswith("; finished work is kept; continue with cgtorch-train --resume runs/one\n")


def test_what_is_said_cannot_control_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    say("name \x1b[2J\x9b31m is \u202e odd")
    assert capsys.readouterr().out == "name \\x1b[2J\\x9b31m is \\u202e odd\n"
    written = io.StringIO()
    console = partial(Console, file=written, force_terminal=True, width=90)
    monkeypatch.setattr("rich.console.Console", lambda stderr: console())
    with waiting("trying \x1b[2J", quiet=False):
        pass
    assert "trying \\x1b[2J …" in written.getvalue()
    assert "\x1b[2J" not in written.getvalue()
