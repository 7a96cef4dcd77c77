"""Threads that compute side by side, each of them with a single thread inside torch.

Two such threads beat two of torch's own by half where the operations are short, because nobody
waits at the end of every operation (docs/decisions.md). How work is shared out never changes a
result: a piece of work is computed by one thread alone, wherever it ends up.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock

import torch

_lock = Lock()
_pools: dict[int, ThreadPoolExecutor] = {}


@contextmanager
def one_thread_each() -> Iterator[int]:
    """Let torch compute in the calling thread alone, and yield how many threads it used before."""
    count = torch.get_num_threads()
    if count == 1:
        yield count
        return
    torch.set_num_threads(1)
    try:
        yield count
    finally:
        torch.set_num_threads(count)  # also for threads that are still to start


def side_by_side(work: Callable[[], None], times: int, threads: int) -> None:
    """Call `work` `times` over in `threads` threads and return when all calls are done.

    It has to be called within `one_thread_each`. The threads stay for the next call; a process
    that is forked off begins without any.
    """
    with _lock:
        if threads not in _pools:
            _pools[threads] = ThreadPoolExecutor(
                threads, "cgtorch", initializer=torch.set_num_threads, initargs=(1,)
            )
        pool = _pools[threads]
    for done in [pool.submit(work) for _ in range(times)]:
        done.result()


def _forget() -> None:
    """Start a forked process afresh, since threads and locked locks do not survive in it."""
    global _lock
    _lock = Lock()
    _pools.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
