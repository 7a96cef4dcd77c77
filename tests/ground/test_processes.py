"""Work shared out to processes: the results in order, errors as they are, one interrupt."""

import os
import signal
import subprocess
import sys

import pytest

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.ground.processes import in_processes

WORK = """
import os
import time
from cgtorch.ground.processes import in_processes

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


def test_an_error_comes_back_as_it_is():
    def work(number: int) -> int:
        if number == 1:
            raise SettingsError("this one")
        return number

    with pytest.raises(SettingsError, match="this one"):
        in_processes(work, 3, 2, lambda _: None)


def test_a_killed_process_is_told():
    def work(number: int) -> int:
        os.kill(os.getpid(), signal.SIGKILL)
        return number

    with pytest.raises(DataError, match="was killed"):
        in_processes(work, 3, 2, lambda _: None)


def test_an_interrupt_is_told_once() -> None:
    """Ctrl-C in a terminal reaches all processes."""
    running = subprocess.Popen(
        [sys.executable, "-c", WORK], start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert running.stdout is not None
    assert {running.stdout.readline() for _ in range(3)} == {"begun\n", "done\n"}
    os.killpg(running.pid, signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert (out, err) == ("interrupted\n", "")
