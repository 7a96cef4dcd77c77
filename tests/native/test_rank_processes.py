"""Ranks that a process starts itself: common results, errors, interrupts, and nobody left."""

import faulthandler
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError, SettingsError, WorldError
from cgtorch.native import rank_processes
from cgtorch.native.rank_processes import PATIENCE, end_others, in_ranks, others_started

SOON = 45  # s, far less than what the processes would take

ENDLESS = """
import os, time, torch
from cgtorch.ground import distributed as ranks
from cgtorch.native.rank_processes import in_ranks

def work():
    own = torch.tensor([os.getpid()])
    print(*ranks.all_gather(own, 3).tolist(), flush=True)
    if not ranks.first():
        time.sleep(60)
    ranks.all_gather(own, 3)

try:
    in_ranks(work, 3)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def gone(process: int) -> bool:
    """Whether a process ends soon."""
    for _ in range(10 * SOON):
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except FileNotFoundError:
            return True
        time.sleep(0.1)
    return False


def test_ranks_share_the_work_and_are_gone_afterwards(capfd: pytest.CaptureFixture[str]) -> None:
    found, before = list[int](), dict(os.environ)

    def work() -> None:
        sys.stdout.write("one line\n")
        os.write(2, b"another line\n")
        rank = ranks.share(3).start
        about = torch.tensor([[rank, os.getpid(), ranks.cores(), others_started()]])
        found.extend(ranks.all_gather(about, 3).flatten().tolist())

    in_ranks(work, 3)
    numbers, processes, cores, started = (found[i::4] for i in range(4))
    assert numbers == [0, 1, 2]
    assert processes[0] == os.getpid()
    assert len(set(processes)) == 3
    assert set(cores) == {max(1, len(os.sched_getaffinity(0)) // 3)}
    assert started == [1, 0, 0]
    assert all(gone(each) for each in processes[1:])
    assert capfd.readouterr() == ("one line\n", "another line\n")
    assert (ranks.count(), others_started(), dict(os.environ)) == (1, False, before)


def test_a_single_process_needs_no_ranks() -> None:
    found = list[tuple[int, int]]()
    in_ranks(lambda: found.append((ranks.count(), os.getpid())), 1)
    assert found == [(1, os.getpid())]


def others_fail(error: BaseException) -> Callable[[], None]:
    def work() -> None:
        if ranks.share(3).start == 1:
            raise error
        ranks.wait()

    return work


class OddError(Exception):
    """An error that cannot be sent to another process."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def test_an_error_of_another_rank_is_raised_as_it_is() -> None:
    error = WorldError("this environment")
    error.add_note("finished work is kept")
    with pytest.raises(WorldError, match=r"^this environment") as found:
        in_ranks(others_fail(error), 3)
    assert found.value.__notes__ == ["finished work is kept"]
    with pytest.raises(RuntimeError, match=r"^OddError: 1 and 2$"):
        in_ranks(others_fail(OddError(1, 2)), 3)
    assert not others_started()


def test_an_error_of_another_rank_is_raised_if_it_comes_while_others_still_meet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Gloo's connections end as soon as one rank fails, which may be before the others have met."""

    def met(backend: str, store: torch.distributed.Store, rank: int, world_size: int) -> None:
        if rank == 1:
            raise WorldError("while others meet")
        raise RuntimeError("Gloo connectFullMesh failed: Connection closed by peer")

    monkeypatch.setattr(torch.distributed, "init_process_group", met)
    with pytest.raises(WorldError, match=r"^while others meet$"):
        in_ranks(ranks.wait, 2)
    assert not others_started()


def test_an_error_of_the_first_rank_ends_the_others() -> None:
    processes = list[int]()

    def work() -> None:
        processes.extend(ranks.all_gather(torch.tensor([os.getpid()]), 2).tolist())
        if ranks.first():
            raise SettingsError("mine")
        time.sleep(60)

    began = time.monotonic()
    with pytest.raises(SettingsError, match=r"^mine$"):
        in_ranks(work, 2)
    assert time.monotonic() - began < SOON
    assert gone(processes[1])
    assert ranks.count() == 1


def test_a_failure_after_the_common_work_counts_too() -> None:
    def work() -> None:
        ranks.wait()
        if not ranks.first():
            raise SettingsError("at the end")

    with pytest.raises(SettingsError, match="at the end"):
        in_ranks(work, 2)


def test_who_does_not_end_after_the_common_work_is_not_waited_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def work() -> None:
        ranks.wait()
        if not ranks.first():
            time.sleep(60)

    monkeypatch.setattr(rank_processes, "PATIENCE", 0.1)
    began = time.monotonic()
    in_ranks(work, 2)
    assert time.monotonic() - began < SOON
    assert not others_started()


@pytest.mark.parametrize(
    ("number", "why"),
    [
        (signal.SIGKILL, "perhaps because memory ran out"),
        (signal.SIGTERM, "perhaps because memory ran out"),
        (signal.SIGSEGV, r"compiled code raises, perhaps that of an env.*\(segmentation fault\)"),
    ],
)
def test_a_killed_rank_is_told_once_and_says_which(number: signal.Signals, why: str) -> None:
    def work() -> None:
        if ranks.share(3).start == 1:
            faulthandler.disable()  # which would print where it was
            os.kill(os.getpid(), number)
            time.sleep(60)
        ranks.wait()

    says = rf"^process 2 of 3 .* killed by signal {int(number)}, .*{why}; .*--processes"
    with pytest.raises(RunError, match=says):
        in_ranks(work, 3)
    assert not others_started()


def test_the_first_rank_can_go_on_alone() -> None:
    found, processes = list[int](), list[int]()

    def work() -> None:
        processes.extend(ranks.all_gather(torch.tensor([os.getpid()]), 2).tolist())
        if ranks.first():
            assert others_started()
            end_others()
            found.extend([ranks.count(), ranks.broadcast(5), int(others_started())])
        else:
            ranks.wait()

    in_ranks(work, 2)
    assert found == [1, 5, 0]
    assert gone(processes[1])


def started() -> tuple[subprocess.Popen[str], list[int]]:
    """Endless ranks and their processes, of which the first waits for the others."""
    running = subprocess.Popen(
        [sys.executable, "-c", ENDLESS], start_new_session=True, text=True, stdout=subprocess.PIPE
    )
    assert running.stdout is not None
    return running, [int(word) for word in running.stdout.readline().split()]


def test_an_interrupt_is_heard_while_the_first_rank_waits_for_others() -> None:
    """Ctrl-C in a terminal reaches all processes."""
    running, processes = started()
    time.sleep(0.5)
    os.killpg(running.pid, signal.SIGINT)
    assert running.communicate(timeout=SOON)[0] == "interrupted\n"
    assert all(gone(each) for each in processes)


def test_nobody_is_left_if_the_first_rank_is_killed() -> None:
    running, processes = started()
    running.kill()
    running.wait()
    assert processes[0] == running.pid
    assert all(gone(each) for each in processes[1:])


def test_processes_that_the_work_starts_end_with_their_rank() -> None:
    """As those of a simulator, which an environment may start without ever closing them."""
    found = list[int]()

    def work() -> None:
        child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60,))
        child.start()
        own = torch.tensor([child.pid])
        found.extend(ranks.all_gather(own, 2).tolist())
        if ranks.first():
            child.kill()

    began = time.monotonic()
    in_ranks(work, 2)
    assert time.monotonic() - began < PATIENCE
    assert all(gone(each) for each in found)


def test_where_nothing_can_be_forked_there_is_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    found = list[int]()
    kinds = "get_all_start_methods"
    monkeypatch.setattr(rank_processes.multiprocessing, kinds, lambda: ["spawn"])
    in_ranks(lambda: found.append(ranks.count()), 3)
    assert found == [1]
