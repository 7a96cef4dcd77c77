"""Errors beside the work of a command."""

import sys
import threading
from collections.abc import Iterator

import pytest
import torch

from cgtorch.commands.aside import tell_in_lines
from cgtorch.ground.fields import Field

assert torch  # without which nothing of the user's has been called


@pytest.fixture
def _told() -> Iterator[None]:
    before = threading.excepthook, sys.unraisablehook
    end = tell_in_lines("made")
    yield
    end()
    assert (threading.excepthook, sys.unraisablehook) == before


def fail(error: BaseException) -> None:
    raise error


class Ends:
    def __del__(self) -> None:
        raise AttributeError("viewer")


def run(error: BaseException) -> None:
    thread = threading.Thread(target=fail, args=(error,))
    thread.start()
    thread.join()


@pytest.mark.usefixtures("_told")
def test_an_error_of_a_thread_or_an_object_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        run(OSError("no \x1b[31m camera"))
        Ends()
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("made: a thread raised OSError: no \\x1b[31m camera in line ")
    assert first.endswith(" of test_aside.py; it goes on without")
    assert second.startswith("made: what ends an object or the program raised AttributeError: v")


@pytest.mark.usefixtures("_told")
def test_an_error_of_ours_has_its_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    thread = threading.Thread(target=Field, args=("x",), kwargs={"kind": 3})
    thread.start()
    thread.join()
    threading.excepthook(threading.ExceptHookArgs((OSError, OSError(28), None, thread)))
    said = capsys.readouterr().err
    assert "Traceback" in said
    assert "OSError" not in said, "as the command says so"
