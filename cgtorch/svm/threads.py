"""One torch thread each, for work in several threads or processes.

The distribution of work never changes a result: a piece of work is computed by one thread alone,
wherever that is.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache

import torch


@contextmanager
def one_thread_each() -> Iterator[int]:
    """Let torch use one thread in this context, and yield the number of threads before."""
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
    """`count` threads with one torch thread each, which live as long as the process.

    A thread that ends holds a lock of MKL for a moment, even after Python has joined it. A process
    that is forked at that moment would wait for that lock for ever.
    """
    return _threads_of(os.getpid(), count)


@cache
def _threads_of(process: int, count: int) -> ThreadPoolExecutor:  # a fork has no threads
    return ThreadPoolExecutor(count, "cgtorch", torch.set_num_threads, (1,))
