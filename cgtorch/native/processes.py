"""Work in forked processes or in several threads, and how far it has come.

The distribution of work never changes a result: one thread alone computes a piece of work. Python's
threads would wait for the interpreter lock in short operations (docs/decisions/models.md).
"""

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any, TypeAlias, TypeVar

import torch

from cgtorch import native
from cgtorch.ground.errors import DataError

Result = TypeVar("Result")
Listener: TypeAlias = Callable[[str, int, int], None]
"""Is told what is counted, how much of it is done, and how much there is in all."""

SOON = 0.5  # s in which a signal reaches all processes
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)
_work: Callable[[int], Any]
_forked = False


def in_processes(
    work: Callable[[int], Result],
    times: int,
    processes: int,
    done: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """The results of work(0) ... work(times - 1), in this order; the first ones begin first.

    A forked process has all data at once and uses one torch thread. `work` must not draw from a
    generator that it shares. Its results are pickled, and `done` is called with each as it arrives.
    With one process, on a system that cannot fork, and within a forked process, `work` is called in
    this process. DataError if a process was killed; otherwise any exception of `work` is raised.
    """
    results: dict[int, Result] = {}

    def keep(number: int, result: Result) -> None:
        results[number] = result
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
            time.sleep(SOON)  # so that Ctrl-C, if it was that, comes here, too
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
    threading.Thread(target=follow, args=(parent,), daemon=True).start()


def follow(parent: int, group: bool = False) -> None:
    """Exit when the parent process ends, even if it was killed.

    A leader of a process group ends its `group`, too.
    """
    while os.getppid() == parent:
        time.sleep(1)
    if group:
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def _call(number: int) -> bytes:
    # Tensors would be left in shared memory, for which their process has to stay.
    return pickle.dumps(_work(number))


@contextmanager
def one_thread_each() -> Iterator[int]:
    """Let torch use one thread in this context, and yield the number of threads before."""
    count = torch.get_num_threads()
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


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """A context in which a listener, and no other, is told what `counted` tells."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def counted(what: str, total: int) -> Callable[[int], None]:
    """Announce `total` steps of work; the returned function is called with each further number.

    It changes no result, and without listeners nothing happens, so that work deep below a
    command needs no display.
    """
    done = 0

    def more(count: int) -> None:
        nonlocal done
        done = min(done + count, total)
        if (listener := _listener.get()) is not None:
            listener(what, done, total)

    more(0)
    return more
