"""One thread inside torch, for work that is shared out to threads or processes of its own.

How work is shared out never changes a result: a piece of work is computed by one thread alone,
wherever it ends up.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache

import torch


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


def kept_threads(count: int) -> ThreadPoolExecutor:
    """`count` threads of one torch thread each, which wait for more work while the process lives.

    A thread that ends holds a lock of MKL for a moment, even after Python has joined it. A process
    that is forked just then waits for that lock for ever.
    """
    return _threads_of(os.getpid(), count)


@cache
def _threads_of(process: int, count: int) -> ThreadPoolExecutor:  # a fork has no threads
    return ThreadPoolExecutor(count, "cgtorch", torch.set_num_threads, (1,))
