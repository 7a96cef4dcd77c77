"""Work in processes: results in order, errors as they are, one interrupt; and who is told of it."""

import os
import signal
import subprocess
import sys

import pytest
import torch

from cgtorch import native
from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.native.processes import (
    counted,
    in_processes,
    kept_threads,
    listening,
    one_thread_each,
)

WORK = """
import os
import time
from cgtorch.native.processes import in_processes

def work(number):
    os.write(1, b"begun\\n")  # a line at once, whoever else writes
    time.sleep(60 * number)  # the first one soon has nothing more to do

try:
    in_processes(work, 2, 2, lambda done: os.write(1, b"done\\n"))
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_results_come_in_order_and_are_told(processes):
    told = []
    found = in_processes(lambda number: (number, os.getpid()), 5, processes, told.append)
    assert [number for number, _ in found] == list(range(5))
    assert sorted(told) == sorted(found)
    assert (os.getpid() in {process for _, process in found}) == (processes == 1)


def refused(number: int) -> int:
    if number == 1:
        raise SettingsError("this one")
    return number


@pytest.mark.parametrize(
    ("work", "error", "says"),
    [
        (refused, SettingsError, "this one"),
        (lambda _: os.kill(os.getpid(), signal.SIGKILL), DataError, "was killed"),
    ],
)
def test_an_error_comes_back_as_it_is_and_a_killed_process_is_told(work, error, says):
    with pytest.raises(error, match=says):
        in_processes(work, 3, 2)


def test_an_interrupt_is_told_once() -> None:
    """Ctrl-C in a terminal reaches all processes."""
    running = subprocess.Popen(
        [sys.executable, "-c", WORK], start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert running.stdout is not None
    assert {running.stdout.readline() for _ in range(3)} == {"begun\n", "done\n"}
    os.killpg(running.pid, signal.SIGINT)
    assert running.communicate(timeout=60) == ("interrupted\n", "")


def test_what_is_counted_is_told_to_whoever_listens_and_to_nobody_else() -> None:
    told: list[tuple[str, str, int, int]] = []
    more = counted("grasps", 5)
    more(1)
    with listening(lambda *given: told.append(("outer", *given))):
        with listening(lambda *given: told.append(("inner", *given))):
            counted("motions", 1)
        more(2)
        more(4)
    more(1)
    assert told == [
        ("inner", "motions", 0, 1),
        ("outer", "grasps", 3, 5),
        ("outer", "grasps", 5, 5),
    ]


def test_a_process_has_one_thread_and_forks_no_others() -> None:
    def about(_: int) -> tuple[int, int, bool]:
        inner = in_processes(lambda _: os.getpid(), 3, 3)
        return torch.get_num_threads(), native.threads(), set(inner) == {os.getpid()}

    torch.set_num_threads(3)
    native.use_threads(2)
    assert in_processes(about, 2, 2) == [(1, 1, True)] * 2
    assert (torch.get_num_threads(), native.threads()) == (3, 2)
    native.use_threads(0)


def test_torch_has_one_thread_for_a_while_and_in_threads_that_are_kept() -> None:
    torch.set_num_threads(3)
    with one_thread_each() as before:
        assert (before, torch.get_num_threads()) == (3, 1)
    assert torch.get_num_threads() == 3
    pool = kept_threads(2)
    assert pool is kept_threads(2)
    assert pool is not kept_threads(1)
    assert pool.submit(torch.get_num_threads).result() == 1
