"""One thread inside torch, for work that is shared out to threads or processes of its own.

How work is shared out never changes a result: a piece of work is computed by one thread alone,
wherever it ends up.
"""

from collections.abc import Iterator
from contextlib import contextmanager

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
