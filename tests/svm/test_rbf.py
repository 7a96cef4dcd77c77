"""Kernel matrices and fused values: right, the same in whatever company and on any threads."""

import os
import subprocess
import sys
import threading

import pytest
import torch
from dual_problems import rows
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.native import available, constants
from cgtorch.svm import rbf as module
from cgtorch.svm.rbf import Gram, chunk_rows, predict_rbf, rbf

FLOATS = [torch.float32, torch.float64]


def problem(count, features, centres, outputs, dtype, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(shape, dtype=dtype, generator=generator)

    gamma = torch.tensor(0.3 / features, dtype=dtype)
    machine = draw(centres, features), draw(centres, outputs), draw(outputs), gamma
    return draw(count, features), machine


sizes = {
    "features": st.integers(1, 20),
    "centres": st.integers(1, 700),
    "outputs": st.integers(1, 18),
    "dtype": st.sampled_from(FLOATS),
    "seed": st.integers(0, 99),
}


@given(count=st.integers(0, 600), **sizes)
@settings(max_examples=30)
def test_values_and_nearest_distance_are_those_of_the_definition(count, dtype, **given):
    x, machine = problem(count, dtype=dtype, **given)
    values, nearest = predict_rbf(x, *machine)
    assert torch.equal(values, predict_rbf(x, *machine, with_nearest=False)[0])
    if count:
        centres, weights, bias, gamma = (each.double() for each in machine)
        exponent = gamma * torch.cdist(x.double(), centres).square()
        right, tolerance = (-exponent).exp() @ weights + bias, 3e-4 if dtype == FLOATS[0] else 1e-10
        assert torch.allclose(values.double(), right, atol=tolerance * len(centres) ** 0.5)
        distance = exponent.amin(1) / torch.log(torch.tensor(2.0).double())
        assert torch.allclose(nearest.double(), distance, atol=tolerance, rtol=tolerance)


@given(data=st.data(), **sizes)
@settings(max_examples=30)
def test_a_row_has_the_same_values_in_every_batch(data, **given):
    x, machine = problem(1300, **given)
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
    x, machine = problem(9001, 6, 2003, outputs, dtype)
    assert chunk_rows(2003, x.element_size()) * 4 < 9001
    values, _ = predict_rbf(x, *machine)
    for part in (slice(0, 1), slice(9000, 9001), slice(505, 1021), slice(4444, 4447)):
        assert torch.equal(predict_rbf(x[part], *machine)[0], values[part])


@pytest.mark.parametrize("outputs", [1, 7])
def test_threads_change_nothing_and_are_kept(outputs):
    x, machine = problem(12_000, 8, 300, outputs, torch.float32)
    alone = predict_rbf(x, *machine)
    torch.set_num_threads(2)
    small = predict_rbf(x[:64], *machine)
    shared = predict_rbf(x, *machine)
    with torch.inference_mode():
        inferred = predict_rbf(x, *machine)
    running = threading.active_count()
    predict_rbf(x, *machine)
    assert threading.active_count() == running
    assert torch.get_num_threads() == 2
    for one, two, three in zip(alone, shared, inferred, strict=True):
        assert torch.equal(one, two)
        assert torch.equal(one, three)
    assert torch.equal(alone[0][:64], small[0])


FORKS = """
import os, torch
from cgtorch.svm.rbf import predict_rbf
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

    x, machine = problem(12_000, 8, 300, 1, torch.float32)
    monkeypatch.setattr(module, "_filler", lambda *_: fails)
    torch.set_num_threads(2)
    with pytest.raises(ValueError, match="no"):
        predict_rbf(x, *machine)


def test_chunks_are_whole_and_bounded():
    for centres in (1, 16, 304, 1008, 5008, 10**6, 10**8):
        count = chunk_rows(centres, 4)
        assert count % 48 == 0
        assert 48 <= count <= 1024
        assert count == 48 or count * centres * 4 <= 2**28


def test_gradients_are_those_of_the_definition():
    x, machine = problem(5, 3, 20, 2, torch.float64)
    plain = predict_rbf(x, *machine)[0]
    x.requires_grad_()
    assert torch.autograd.gradcheck(lambda rows: predict_rbf(rows, *machine), (x,))
    assert torch.allclose(predict_rbf(x, *machine)[0], plain, atol=1e-12)


@pytest.mark.parametrize("n", [1, 15, 16, 17, 100])
def test_kernel_matrices_are_those_of_torch(n):
    x = 3 * rows(5, n) + 100
    exact, gram = rbf(x, x, 0.3), Gram(x, 0.3)
    assert gram.single.shape == (n, n + -n % 16)
    assert gram.double.shape == (n, n + -n % 8)
    assert bool(torch.isfinite(gram.single).all())
    assert torch.equal(gram.matrix, exact)
    torch.testing.assert_close(gram.single[:, :n].double(), exact, atol=1e-7, rtol=0)


def test_kernels_that_are_not_finite_are_refused():
    with pytest.raises(DataError, match="non-finite"):
        _ = Gram(torch.tensor([[1e200], [-1e200], [1e300]]).double(), 1.0).single


@pytest.mark.parametrize("dtype", FLOATS)
def test_distances_are_sums_of_products_unless_those_would_cost_half_of_the_digits(dtype):
    """Of centres on a circle, the largest square is that of its radius."""
    angle = torch.arange(8) * torch.pi / 4
    circle = torch.stack([angle.cos(), angle.sin()], 1).to(dtype) + 1000
    most = torch.finfo(dtype).eps ** -0.25  # the radius whose square takes half of the digits
    for radius, far in ((0.9 * most, False), (1.1 * most, True)):
        centres = (circle - 1000) * radius
        assert module._far(centres, 1.0) == far
        assert module._far(centres / 3, torch.tensor(9.0)) == far
    assert not module._far(circle, 1.0)  # an offset takes none
    assert not module._far(torch.ones(2, 1, device="meta"), 1.0)  # nobody waits for a GPU


def test_the_width_is_that_of_scikit_learn_or_as_given():
    x = rows(2, 40)
    assert Gram(x, "scale").gamma == pytest.approx(1 / (5 * float(x.numpy().var())))
    assert Gram(torch.ones(3, 2).double(), "scale").gamma == 1
    assert Gram(x, 0.25).gamma == 0.25
    for wrong in (0.0, -1.0, torch.inf, torch.nan, "wide", None):
        with pytest.raises(SettingsError, match='choose "scale" or a positive number'):
            Gram(x, wrong)


@pytest.mark.parametrize(
    ("rows", "centres", "threads"),
    [(1, 1, 1), (2**10, 2**10, 2), (2**10, 2**9, 1), (2**11, 2**10, 3), (2**20, 2**9, 3)],
)
def test_threads_are_as_many_as_pay_off(rows, centres, threads, monkeypatch):
    monkeypatch.setattr(module, "threads", lambda: 3)
    assert module.threads_for(rows, centres) == threads


@pytest.mark.parametrize("offset", [0.0, 1e12])
def test_an_offset_takes_no_digits_from_single_precision(offset):
    x = rows(5, 17) + offset
    gram = Gram(x, 0.3)
    torch.testing.assert_close(gram.single[:, :17].double(), gram.matrix, atol=1e-6, rtol=0)


@pytest.mark.skipif(not available(), reason="there is no C compiler")
@pytest.mark.parametrize("dtype", FLOATS)
def test_machines_up_to_a_size_are_compiled(dtype):
    most = constants("machine_limits", dtype)
    for features, outputs, centres, there in (
        (most["MOST_FEATURES"], 1, 3, True),
        (most["MOST_FEATURES"] + 1, 1, 3, False),
        (2, most["MOST_OUTPUTS"], 3, True),
        (2, most["MOST_OUTPUTS"] + 1, 3, False),
        (2, 1, 0, False),
        (0, 1, 3, False),
    ):
        _, machine = problem(4, max(features, 1), centres, outputs, dtype)
        machine = (machine[0][:, :features], *machine[1:])
        assert (module.machine_structure(*machine) is not None) == there
    x, machine = problem(50, 4, 33, 3, dtype)
    values, nearest = module.machine_values(x, *machine)
    wanted = predict_rbf(x, *machine)
    tolerance = 3e-4 if dtype == FLOATS[0] else 1e-10
    torch.testing.assert_close(values, wanted[0], atol=tolerance, rtol=tolerance)
    torch.testing.assert_close(nearest, wanted[1], atol=tolerance, rtol=tolerance)
