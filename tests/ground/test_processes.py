"""Forked processes leave it to their parent to say how work ended."""

import os
import signal
import subprocess
import sys

WORK = """
import time
from cgtorch.ground.processes import in_processes

def work(number):
    print("begun", flush=True)
    time.sleep(60 * number)  # the first one soon has nothing more to do

try:
    in_processes(work, 2, 2, lambda done: print("done", flush=True))
except KeyboardInterrupt:
    print("interrupted")
"""


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
