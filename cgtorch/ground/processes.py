"""Work in forked processes, for operations too short for threads.

Python's threads would wait for the interpreter lock (docs/decisions/models.md). A forked process
has all data at once and uses one torch thread, as in PyTorch's data loaders.
"""

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import torch

from cgtorch import native
from cgtorch.ground.errors import DataError

Result = TypeVar("Result")

_work: Callable[[int], Any]
_forked = False


def in_processes(
    work: Callable[[int], Result],
    times: int,
    processes: int,
    done: Callable[[Result], None] | None = None,
) -> list[Result]:
    """The results of work(0) ... work(times - 1), in this order; the first ones begin first.

    `work` must not draw from a generator that it shares. Its results are pickled, and `done` is
    called with each as it arrives. With one process, on a system that cannot fork, and within a
    forked process, `work` is called in this process. DataError if a process was killed; otherwise
    any exception of `work` is raised.
    """
    results: dict[int, Result] = {}

    def keep(number: int, result: Result) -> None:
        results[number] = result
        if done is not None:
            done(result)

    forks = not _forked and "fork" in multiprocessing.get_all_start_methods()
    if not forks or min(processes, times) < 2:
        for number in range(times):
            keep(number, work(number))
        return list(results.values())
    context = multiprocessing.get_context("fork")
    about = work, os.getpid()
    with ProcessPoolExecutor(min(processes, times), context, _begin, about) as pool:
        numbers = {pool.submit(_call, number): number for number in range(times)}
        try:
            for sent in as_completed(numbers):
                keep(numbers[sent], pickle.loads(sent.result()))  # noqa: S301  of our own process
        except BrokenProcessPool as e:
            raise DataError(
                f"one of {processes} processes was killed, probably because memory ran out; use "
                "torch.set_num_threads(1) to use one only"
            ) from e
        finally:
            pool.shutdown(cancel_futures=True)
    return [results[number] for number in range(times)]


def _begin(work: Callable[[int], Any], parent: int) -> None:
    global _work, _forked
    signal.signal(signal.SIGINT, lambda *_: os._exit(1))  # the parent process says it once
    torch.set_num_threads(1)
    native.use_threads(1)
    _work, _forked = work, True
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: int) -> None:
    """Exit when the parent process ends, even if it was killed."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def _call(number: int) -> bytes:
    # Tensors would be left in shared memory, for which their process has to stay.
    return pickle.dumps(_work(number))
