"""Threads that stay: asked by several at once, and in a process that was forked."""

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from torch import Tensor

from cgtorch.native import available, function

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

ROWS = 1600
COLUMNS = torch.randn(5, ROWS, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def kernel_matrix(_: object = None) -> Tensor:
    found = torch.empty(ROWS, ROWS)
    call = function("rbf_gram", torch.float32)
    assert call is not None
    call(COLUMNS, ROWS, len(COLUMNS), ROWS, found, 3)
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
