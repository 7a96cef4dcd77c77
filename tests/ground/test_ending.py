"""The end of a process."""

import subprocess
import sys

import pytest

STUCK = {
    "thread": "threading.Thread(target=time.sleep, args=(60,)).start()",
    "close": "at_end(lambda: time.sleep(60))",
    "del": """
class Stuck:
    def __del__(self): time.sleep(60)
def work():
    stuck = Stuck()
    sys.exit(3)
""",
}


LEFT = """
try: work()
except SystemExit:
    ending.set()
    raise
"""


def ended(
    work: str, patience: float, end: str = "sys.exit(3)"
) -> "subprocess.CompletedProcess[str]":
    program = (
        "import sys, threading, time\n"
        "from cgtorch.ground.ending import at_end, end_in_time\n"
        f"{work}\nprint('done', end='')\nending = end_in_time('made', 3, {patience})\n{end}"
    )
    how = {"capture_output": True, "text": True, "timeout": 30, "check": False}
    return subprocess.run([sys.executable, "-c", program], **how)  # type: ignore[call-overload,no-any-return]


@pytest.mark.parametrize("what", STUCK)
def test_a_process_ends_whatever_goes_on(what: str) -> None:
    found = ended(STUCK[what], 0.2, "sys.exit(3)" if what != "del" else LEFT)
    assert (found.returncode, found.stdout) == (3, "done")
    assert found.stderr.startswith("made: a thread, a process or a close() ")
    assert found.stderr.count("\n") == 1


def test_a_process_that_ends_by_itself_does_all_that_was_registered() -> None:
    found = ended("import atexit; atexit.register(lambda: print(' at last'))", 20)
    assert (found.returncode, found.stdout, found.stderr) == (3, "done at last\n", "")


def test_a_process_that_goes_on_is_left_alone() -> None:
    found = ended("end_in_time('made', 1, 0)\ntime.sleep(0.2)", 20)
    assert (found.returncode, found.stdout, found.stderr) == (3, "done", "")
