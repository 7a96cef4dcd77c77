"""Threads that stay: asked by several at once, and in a process that was forked."""

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from torch import Tensor

from cgtorch import native
from cgtorch.svm.gram import Gram

GENERATOR = torch.Generator().manual_seed(0)
MATRIX = torch.randn(3000, 3000, generator=GENERATOR, dtype=torch.float64)
SPARSE = torch.randn(5, 3000, generator=GENERATOR, dtype=torch.float64)
SPARSE *= torch.rand(5, 3000, generator=GENERATOR) < 0.3


def product(_: object = None) -> Tensor:
    return Gram(MATRIX).times(SPARSE)


@pytest.fixture(autouse=True)
def three_threads():
    before = native.use_threads(3)
    yield
    native.use_threads(before)


def test_several_callers_at_once_all_get_their_results() -> None:
    expected = product()
    with ThreadPoolExecutor(6) as pool:
        for found in pool.map(product, range(60)):
            assert torch.equal(found, expected)


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="there is no fork"
)
def test_a_forked_process_has_threads_of_its_own() -> None:
    expected = product()
    context = multiprocessing.get_context("fork")
    with ThreadPoolExecutor(2) as busy:  # so that one is at it, with its locks, as it forks
        others = [busy.submit(product) for _ in range(40)]
        for _ in range(5):
            receiver, sender = context.Pipe(duplex=False)
            child = context.Process(target=lambda s=sender: s.send(product().numpy()))
            child.start()
            assert receiver.poll(60)
            assert torch.equal(torch.from_numpy(receiver.recv()), expected)
            child.join()
        assert all(torch.equal(other.result(), expected) for other in others)
