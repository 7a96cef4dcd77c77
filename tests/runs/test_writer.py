"""One writer to a run: who comes second is told, and a lock ends with its process."""

import errno
import fcntl
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cgtorch.ground.errors import RunError
from cgtorch.runs.writer import NO_LOCKS, WRITER, place_now, sole_writer

HOLD = """
import os, sys, time
from pathlib import Path
from cgtorch.runs.writer import sole_writer
with sole_writer(Path(sys.argv[1])):
    if sys.argv[2:] != ["fork"] or os.fork() == 0:
        print("held", flush=True)
    time.sleep(10)
"""
TAKEN = r"run '.*' is written by process {} on \S.* since 20\d\d-\d\d-\d\d \d\d:\d\d:\d\d; wait for"


def holding(folder: Path, *how: str) -> subprocess.Popen[str]:
    """Another process that writes to a run."""
    words = [sys.executable, "-c", HOLD, str(folder), *how]
    other = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    return other


def enter(folder: Path) -> None:
    with sole_writer(folder):
        pass


def test_the_second_is_told_who_writes_and_since_when(tmp_path: Path) -> None:
    other = holding(tmp_path)
    with pytest.raises(RunError, match=TAKEN.format(other.pid)):
        enter(tmp_path)
    other.send_signal(signal.SIGKILL)
    other.wait()
    began = int(time.time())
    with sole_writer(tmp_path):
        about = json.loads((tmp_path / WRITER).read_text())
    assert about["process"] == os.getpid()
    assert began <= about["since"] <= time.time()


def test_the_lock_stays_with_a_folder_that_is_renamed(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    with sole_writer(first):
        first.rename(second)
        first.mkdir()
        enter(first)
        with pytest.raises(RunError, match=TAKEN.format(os.getpid())):
            enter(second)
    enter(second)


@pytest.mark.parametrize(
    "said", [b"", b"{}", b"\xff", b'{"process": 1, "machine": "a", "since": 1e300}']
)
def test_a_file_that_says_nothing_is_no_reason_to_fail(tmp_path: Path, said: bytes) -> None:
    with sole_writer(tmp_path):
        (tmp_path / WRITER).write_bytes(said)
        with pytest.raises(RunError, match=r"is written by another process; wait for its end"):
            enter(tmp_path)
    with sole_writer(tmp_path):
        assert json.loads((tmp_path / WRITER).read_text())["process"] == os.getpid()
    assert not (tmp_path / WRITER).exists()


def test_a_file_that_an_earlier_writer_removed_meanwhile_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its lock would keep nobody out."""
    lock, calls = fcntl.flock, list[int]()

    def late(file: int, how: int) -> None:
        calls.append(how)
        if len(calls) == 1:
            (tmp_path / WRITER).unlink()
        lock(file, how)

    monkeypatch.setattr("fcntl.flock", late)
    with sole_writer(tmp_path):
        assert len(calls) == 2
        with pytest.raises(RunError, match=r"is written by process"):
            enter(tmp_path)


def test_a_forked_process_does_not_hold_the_lock_of_its_parent(tmp_path: Path) -> None:
    other = holding(tmp_path, "fork")
    other.send_signal(signal.SIGKILL)
    other.wait()
    enter(tmp_path)  # though the other's child goes on
    with sole_writer(tmp_path):
        child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(30,))
        child.start()
    enter(tmp_path)
    child.kill()  # as what runs the tests may ignore a request to end
    child.join()


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"cannot write '.*none' \(No such file"):
        enter(tmp_path / "none")


def test_a_folder_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    folder = Path(os.fsdecode(bytes(tmp_path) + b"/M\xfcller"))
    folder.mkdir()
    with pytest.raises(RunError, match=r"folder '.*ller' is no valid UTF-8; rename it, or choose"):
        enter(folder)
    assert not list(folder.iterdir())


def test_a_log_that_cannot_be_written_is_told_before_anything_is(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").mkdir()
    with pytest.raises(RunError, match=r"cannot write '.*log.jsonl' \(Is a directory\)"):
        enter(tmp_path)
    assert not (tmp_path / WRITER).exists()


FAILURES = [RunError("cannot write"), FileNotFoundError("gone"), ValueError("odd")]


@pytest.mark.parametrize("error", FAILURES, ids=str)
def test_where_a_folder_is_that_was_renamed_is_told(tmp_path: Path, error: Exception) -> None:
    first, second = tmp_path / "first", tmp_path / "second"

    def write(rename: bool) -> None:
        with sole_writer(first):
            if rename:
                first.rename(second)
            raise error

    first.mkdir()
    with pytest.raises(type(error), match=f"^{error}$"):
        write(rename=False)
    moved = r"first' was moved or removed while .* no longer there but at '.*second'; continue it"
    told = isinstance(error, OSError | RunError)
    with pytest.raises((RunError, ValueError), match=moved if told else "odd"):
        write(rename=True)
    assert not list(second.iterdir())


def test_a_run_is_found_where_it_is_now(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    assert place_now(first) == first  # to which nobody writes
    with sole_writer(first):
        (first / WRITER).unlink()
        assert place_now(first) == first
    with sole_writer(first):
        first.rename(second)
        first.mkdir()
        assert place_now(first) == second
        (second / WRITER).unlink()
        second.rmdir()
        assert place_now(first) is None


@pytest.mark.parametrize("number", NO_LOCKS)
def test_where_nothing_can_be_locked_a_run_is_written_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuses(file: int, how: int) -> None:
        raise OSError(number, "no locks")

    monkeypatch.setattr(fcntl, "flock", refuses)
    with sole_writer(tmp_path):
        assert json.loads((tmp_path / WRITER).read_text())["process"] == os.getpid()
        enter(tmp_path)


def test_another_failure_of_a_lock_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(file: int, how: int) -> None:
        raise OSError(errno.EIO, "broken")

    monkeypatch.setattr(fcntl, "flock", fails)
    before = len(os.listdir("/proc/self/fd")) if os.path.exists("/proc/self/fd") else 0
    with pytest.raises(OSError, match="broken"):
        enter(tmp_path)
    assert not before or len(os.listdir("/proc/self/fd")) == before  # and the file is closed
