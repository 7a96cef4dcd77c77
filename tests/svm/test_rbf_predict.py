"""The fused values: right, and the same for a row in whatever company and on how many threads."""

import os
import subprocess
import sys
import threading

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.svm import rbf_predict
from cgtorch.svm.rbf_predict import chunk_rows, predict_rbf

FLOATS = [torch.float32, torch.float64]


def _problem(rows, features, centres, outputs, dtype, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(shape, dtype=dtype, generator=generator)

    gamma = torch.tensor(0.3 / features, dtype=dtype)
    machine = draw(centres, features), draw(centres, outputs), draw(outputs), gamma
    return draw(rows, features), machine


def _plain(x, centres, weights, bias, gamma):
    distance = torch.cdist(x.double(), centres.double()).square()
    values = (-gamma.double() * distance).exp() @ weights.double() + bias.double()
    return values, distance.amin(1) * gamma.double() / torch.log(torch.tensor(2.0).double())


sizes = {
    "features": st.integers(1, 20),
    "centres": st.integers(1, 700),
    "outputs": st.integers(1, 18),
    "dtype": st.sampled_from(FLOATS),
    "seed": st.integers(0, 99),
}


@given(rows=st.integers(0, 600), **sizes)
def test_values_and_nearest_distance_are_those_of_the_definition(rows, **problem):
    x, machine = _problem(rows, **problem)
    values, nearest = predict_rbf(x, *machine)
    assert torch.equal(values, predict_rbf(x, *machine, with_nearest=False)[0])
    if rows:
        tolerance = 3e-4 if problem["dtype"] == torch.float32 else 1e-10
        right, distance = _plain(x, *machine)
        assert torch.allclose(values.double(), right, atol=tolerance * problem["centres"] ** 0.5)
        assert torch.allclose(nearest.double(), distance, atol=tolerance, rtol=tolerance)


@given(data=st.data(), **sizes)
def test_a_row_has_the_same_values_in_every_batch(data, **problem):
    x, machine = _problem(1300, **problem)
    values, nearest = predict_rbf(x, *machine)
    begin = data.draw(st.integers(0, 1299))
    end = data.draw(st.integers(begin + 1, 1300))
    part, part_nearest = predict_rbf(x[begin:end], *machine)
    assert torch.equal(part, values[begin:end])
    assert torch.equal(part_nearest, nearest[begin:end])
    order = torch.tensor(data.draw(st.lists(st.integers(0, 1299), min_size=1, max_size=40)))
    assert torch.equal(predict_rbf(x[order], *machine)[0], values[order])


@pytest.mark.parametrize("outputs", [1, 7])
@pytest.mark.parametrize("dtype", FLOATS)
def test_more_rows_than_a_block_and_more_centres_than_fit_change_nothing(outputs, dtype):
    x, machine = _problem(9001, 6, 2003, outputs, dtype)
    assert chunk_rows(2003, x.element_size()) * 4 < 9001
    values, _ = predict_rbf(x, *machine)
    for rows in (slice(0, 1), slice(9000, 9001), slice(505, 1021), slice(4444, 4447)):
        assert torch.equal(predict_rbf(x[rows], *machine)[0], values[rows])


@pytest.mark.parametrize("outputs", [1, 7])
def test_threads_change_nothing_and_are_kept(outputs):
    x, machine = _problem(12_000, 8, 300, outputs, torch.float32)
    alone = predict_rbf(x, *machine)
    torch.set_num_threads(2)
    try:
        small = predict_rbf(x[:64], *machine)
        shared = predict_rbf(x, *machine)
        with torch.inference_mode():
            inferred = predict_rbf(x, *machine)
        running = threading.active_count()
        predict_rbf(x, *machine)
        assert threading.active_count() == running
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    for one, two, three in zip(alone, shared, inferred, strict=True):
        assert torch.equal(one, two)
        assert torch.equal(one, three)
    assert torch.equal(alone[0][:64], small[0])


FORKS = """
import os, torch
from cgtorch.svm.rbf_predict import predict_rbf
torch.set_num_threads(2)
x, c, w = torch.ones(12_000, 3), torch.ones(300, 3), torch.ones(300, 1)
machine = (c, w, torch.zeros(1), torch.tensor(1.0))
predict_rbf(x, *machine)
child = os.fork()
if child == 0:
    os._exit(round(float(predict_rbf(x, *machine)[0][0, 0])) - 300)
raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_process_computes_with_threads_of_its_own():
    subprocess.run([sys.executable, "-W", "ignore", "-c", FORKS], check=True, timeout=60)


def test_an_error_in_a_thread_reaches_the_caller(monkeypatch):
    def fails(*_):
        raise ValueError("no")

    x, machine = _problem(12_000, 8, 300, 1, torch.float32)
    monkeypatch.setattr(rbf_predict, "_filler", lambda *_: fails)
    torch.set_num_threads(2)
    try:
        with pytest.raises(ValueError, match="no"):
            predict_rbf(x, *machine)
    finally:
        torch.set_num_threads(1)


def test_chunks_are_whole_and_bounded():
    for centres in (1, 16, 304, 1008, 5008, 10**6, 10**8):
        rows = chunk_rows(centres, 4)
        assert rows % 48 == 0
        assert 48 <= rows <= 1024
        assert rows == 48 or rows * centres * 4 <= 2**28


def test_gradients_are_those_of_the_definition():
    x, machine = _problem(5, 3, 20, 2, torch.float64)
    x.requires_grad_()
    assert torch.autograd.gradcheck(lambda rows: predict_rbf(rows, *machine), (x,))
    assert torch.allclose(
        predict_rbf(x, *machine)[0], predict_rbf(x.detach(), *machine)[0], atol=1e-12
    )
