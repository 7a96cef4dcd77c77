"""Work shared out to forked processes, for operations too short to be shared out to threads.

Threads of Python's would wait for one another's interpreter lock (docs/decisions.md). A forked
process has all data at once and one thread inside torch, as PyTorch's own data loaders do it.
"""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import torch

from cgtorch.errors import DataError

Result = TypeVar("Result")

_work: Callable[[int], Any]


def in_processes(
    work: Callable[[int], Result], times: int, processes: int, done: Callable[[Result], None]
) -> list[Result]:
    """The results of work(0) ... work(times - 1), in this order.

    Args:
        work: Must not draw from a generator that it shares; its results are sent by pickle.
        times: How often to call it; the first are begun first.
        processes: How many to use; one, or a system that cannot fork, calls it here.
        done: Called here with each result as it comes.

    Raises:
        DataError: A process was killed, as a rule for want of memory.
        Exception: Whatever `work` raised.
    """
    if min(processes, times) < 2 or "fork" not in multiprocessing.get_all_start_methods():
        return [_told(work(number), done) for number in range(times)]
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(min(processes, times), context, _begin, (work,)) as pool:
        results = [pool.submit(_call, number) for number in range(times)]
        try:
            for result in as_completed(results):
                done(result.result())
        except BrokenProcessPool as e:
            raise DataError(
                f"one of {processes} processes was killed, as a rule for want of memory; use "
                "torch.set_num_threads(1) to use one only"
            ) from e
        finally:
            pool.shutdown(cancel_futures=True)
    return [result.result() for result in results]


def _told(result: Result, done: Callable[[Result], None]) -> Result:
    done(result)
    return result


def _begin(work: Callable[[int], Any]) -> None:
    global _work
    torch.set_num_threads(1)
    _work = work


def _call(number: int) -> Any:
    return _work(number)
