"""Threads that stay: asked by several at once, and in a process that was forked."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import pytest
import torch
from torch import Tensor

from cgtorch.native import available, function

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

ROWS = 1600
T = TypeVar("T")
COLUMNS = torch.randn(5, ROWS, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def kernel_matrix(_: object = None, threads: int = 3) -> Tensor:
    found = torch.empty(ROWS, ROWS)
    call = function("rbf_gram", torch.float32)
    assert call is not None
    call(COLUMNS, ROWS, len(COLUMNS), ROWS, found, threads)
    return found


def test_several_callers_at_once_all_get_their_results() -> None:
    expected = kernel_matrix()
    with ThreadPoolExecutor(6) as pool:
        for found in pool.map(kernel_matrix, range(60)):
            assert torch.equal(found, expected)


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="there is no fork"
)
def test_a_forked_process_has_threads_of_its_own() -> None:
    expected = kernel_matrix()
    context = multiprocessing.get_context("fork")
    with ThreadPoolExecutor(2) as busy:  # so that one is at it, with its locks, as it forks
        others = [busy.submit(kernel_matrix) for _ in range(40)]
        for _ in range(5):
            receiver, sender = context.Pipe(duplex=False)
            child = context.Process(target=lambda s=sender: s.send(kernel_matrix().numpy()))
            child.start()
            assert receiver.poll(60)
            assert torch.equal(torch.from_numpy(receiver.recv()), expected)
            child.join()
        assert all(torch.equal(other.result(), expected) for other in others)


TASKS = Path("/proc/self/task")
on_linux = pytest.mark.skipif(not TASKS.exists(), reason="threads are counted as Linux tells them")


def in_a_child(work: Callable[[], T]) -> T:
    """The result of work in a forked process, which has no threads but its own yet."""
    receiver, sender = multiprocessing.get_context("fork").Pipe(duplex=False)
    child = os.fork()
    if child == 0:
        try:
            sender.send(work())
        finally:
            os._exit(0)
    assert receiver.poll(60)
    result: T = receiver.recv()
    os.waitpid(child, 0)
    return result


def deviations(parts: int, threads: int) -> list[float]:
    """A call in so many parts."""
    scores, found = torch.arange(2.0 * parts).repeat(3, 1), torch.empty(2 * parts)
    scores[0] += 1
    scores[1] -= 2
    call = function("deviation", torch.float32)
    assert call is not None
    call(scores, 3, 2 * parts, found, threads)
    numbers: list[float] = found.tolist()
    return numbers


@on_linux
def test_there_are_as_many_threads_as_were_ever_needed_and_no_more() -> None:
    def counts() -> list[int]:
        found, before = [], len(list(TASKS.iterdir()))
        for parts, threads in (
            (9, 1), (1, 9), (0, 9), (9, 0), (9, 3), (9, 3), (9, 2), (2, 9), (5, 9), (600, 10**6),
            (600, 7),
        ):  # fmt: skip
            assert deviations(parts, threads) == [1.0] * 2 * parts
            found.append(len(list(TASKS.iterdir())) - before)
        return found

    assert in_a_child(counts) == [0, 0, 0, 0, 2, 2, 2, 2, 4, 256, 256]


@on_linux
def test_signals_are_not_for_these_threads() -> None:
    def blocked(task: Path) -> int:
        lines = (task / "status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("SigBlk:")).split()[1], 16)

    def masks() -> tuple[int, int, set[int]]:
        before = {task: blocked(task) for task in TASKS.iterdir()}
        deviations(9, 3)
        new = {blocked(task) for task in TASKS.iterdir() if task not in before}
        (own,) = before
        return before[own], blocked(own), new

    before, after, new = in_a_child(masks)
    assert before == after
    usual = sum(1 << (number - 1) for number in range(1, 32) if number not in (9, 19))
    assert all(mask & usual == usual for mask in new)


@on_linux
def test_others_do_a_part_of_the_work() -> None:
    """One thread more than the caller's, for as long as it takes until the system lets it run."""

    def shared() -> bool:
        def seconds(task: Path) -> float:
            return int((task / "schedstat").read_text().split()[0]) / 1e9

        own = set(TASKS.iterdir())
        deviations(9, 2)
        (other,) = set(TASKS.iterdir()) - own
        for _ in range(100):
            before, begun = seconds(other), sum(map(seconds, own))
            kernel_matrix(threads=2)
            mine = sum(map(seconds, own)) - begun
            if seconds(other) - before > mine / 4:
                return True
        return False

    assert in_a_child(shared)
