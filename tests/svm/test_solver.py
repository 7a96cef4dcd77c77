"""The solver's own promises: optimality, feasibility, and a fallback that agrees."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.errors import ModelError
from cgtorch.svm import active_set, smo, solver
from cgtorch.svm.gram import gram
from cgtorch.svm.newton import solve_free
from cgtorch.svm.problems import Problems, classification, regression


def _kernel(seed, n, gamma, duplicates=False, constant=False):
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(n, 3, generator=generator, dtype=torch.float64)
    if duplicates:
        x = x[torch.arange(n) % (n // 2 + 1)]
    if constant:
        x[:, 1] = 2.0
    return torch.exp(-gamma * torch.cdist(x, x).square()), x, generator


def _check_optimal(kernel, problems, found, relative):
    """KKT conditions within what the gap allows, straight from the definition."""
    beta = found.beta
    assert bool((beta >= problems.lower).all())
    assert bool((beta <= problems.upper).all())
    size = torch.maximum(problems.upper, -problems.lower).amax(1)
    assert bool((beta.sum(1).abs() <= 1e-6 * size * beta.shape[1]).all())
    assert torch.allclose(found.product, beta @ kernel)
    residual = problems.z - beta @ kernel - found.bias[:, None]
    width = problems.epsilon[:, None]
    loss = problems.upper * (residual - width).clamp_min(0)
    loss = loss - problems.lower * (-residual - width).clamp_min(0)
    primal = 0.5 * (beta * (beta @ kernel)).sum(1) + loss.sum(1)
    dual = (problems.z * beta - width * beta.abs()).sum(1) - 0.5 * (beta * (beta @ kernel)).sum(1)
    assert bool((primal - dual <= relative * (primal.abs() + 1e-9)).all())
    assert torch.allclose(found.gap, primal - dual, atol=1e-6 * float(primal.abs().max()) + 1e-9)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(4, 60),
    exponent=st.integers(-4, 9),
    gamma=st.sampled_from([0.001, 0.1, 2.0]),
    duplicates=st.booleans(),
    constant=st.booleans(),
)
def test_classification_is_optimal(seed, n, exponent, gamma, duplicates, constant):
    kernel, x, generator = _kernel(seed, n, gamma, duplicates, constant)
    noisy = x[:, 0] + 0.5 * torch.randn(n, generator=generator, dtype=torch.float64)
    signs = torch.where(noisy > noisy.median(), 1.0, -1.0).double()
    cap = torch.tensor([2.0**exponent], dtype=torch.float64)
    problems = classification(signs, cap, torch.ones(1, n, dtype=torch.float64))
    found = solver.solve(kernel, problems, generator, last=1e-7, tolerance=1e-7)
    _check_optimal(kernel, problems, found, 2e-3 if duplicates else 1e-4)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(2, 60),
    exponent=st.integers(-4, 9),
    gamma=st.sampled_from([0.001, 0.1, 2.0]),
    epsilon=st.sampled_from([0.0, 0.01, 0.3, 100.0]),
    duplicates=st.booleans(),
)
def test_regression_is_optimal(seed, n, exponent, gamma, epsilon, duplicates):
    kernel, x, generator = _kernel(seed, n, gamma, duplicates)
    z = (x[:, 0] * 2).sin() + 0.1 * torch.randn(n, generator=generator, dtype=torch.float64)
    cap = torch.tensor([2.0**exponent], dtype=torch.float64)
    tube = torch.tensor([epsilon], dtype=torch.float64)
    problems = regression(z[None], cap, tube, torch.ones(1, n, dtype=torch.float64))
    found = solver.solve(kernel, problems, generator, last=1e-7, tolerance=1e-7)
    _check_optimal(kernel, problems, found, 2e-3 if duplicates else 1e-3)


@given(seed=st.integers(0, 10**6), exponent=st.integers(-3, 6))
def test_held_out_rows_stay_out(seed, exponent):
    n = 50
    kernel, x, generator = _kernel(seed, n, 0.3)
    signs = torch.where(x[:, 0] + 0.3 * x[:, 1] > 0, 1.0, -1.0).double()
    mask = torch.arange(n)[None] % 5 != torch.arange(5)[:, None]
    cap = torch.full((5,), 2.0**exponent, dtype=torch.float64)
    problems = classification(signs, cap, mask.double())
    found = solver.solve(kernel, problems, generator, last=1e-7)
    assert float(found.beta[~mask].abs().max()) == 0.0
    alone = solver.solve(
        kernel[mask[2]][:, mask[2]],
        classification(signs[mask[2]], cap[:1], torch.ones(1, 40, dtype=torch.float64)),
        generator,
        last=1e-7,
    )
    value = alone.beta @ kernel[mask[2]] + alone.bias[:, None]
    assert torch.allclose(value[0], found.product[2] + found.bias[2], atol=1e-3)


def test_large_problems_start_from_a_quarter_and_agree_with_smo():
    n = 700
    kernel, x, generator = _kernel(1, n, 0.5)
    z = (3 * x[:, 0]).sin() + 0.2 * torch.randn(n, generator=generator, dtype=torch.float64)
    one = torch.ones(1, dtype=torch.float64)
    problems = regression(z[None], 5 * one, 0.1 * one, torch.ones(1, n, dtype=torch.float64))
    found = solver.solve(kernel, problems, generator, last=1e-7)
    assert bool(found.direct.all())
    beta, bias = smo.solve(
        kernel, z, problems.lower[0], problems.upper[0], 0.1, torch.zeros(n), 1e-7
    )
    assert float((beta @ kernel + bias - found.product[0] - found.bias).abs().max()) < 1e-4
    assert abs(float(bias - found.bias)) < 1e-4


def test_what_does_not_converge_is_flagged_and_solved_by_smo(monkeypatch):
    n = 60
    kernel, x, generator = _kernel(3, n, 0.5)
    one = torch.ones(1, dtype=torch.float64)
    problems = regression(x[None, :, 0], 5 * one, 0.1 * one, torch.ones(1, n).double())
    whole = solver.solve(kernel, problems, generator, last=1e-7)
    monkeypatch.setattr(active_set, "_MAX_STEPS", 2)
    found = solver.solve(kernel, problems, generator, last=1e-7, tolerance=1e-8)
    assert not bool(found.direct.any())
    _check_optimal(kernel, problems, found, 1e-4)
    assert torch.allclose(
        found.product + found.bias[:, None], whole.product + whole.bias, atol=1e-4
    )


def test_a_wrong_answer_shows_in_its_gap():
    n = 40
    kernel, x, generator = _kernel(4, n, 0.5)
    one = torch.ones(1, dtype=torch.float64)
    problems = regression(x[None, :, 0], 5 * one, 0.1 * one, torch.ones(1, n).double())
    found = solver.solve(kernel, problems, generator, last=1e-7)
    worse = found.beta * 0.9
    gap = solver.duality_gap(problems, worse, found.bias, worse @ kernel)
    assert float(gap) > 100 * float(found.gap)


def test_smo_says_when_it_cannot(monkeypatch):
    monkeypatch.setattr(smo, "_MAX_STEPS", 3)
    kernel, x, _ = _kernel(5, 50, 0.5)
    cap = torch.full((50,), 10.0)
    with pytest.raises(ModelError, match="3 steps"):
        smo.solve(kernel, x[:, 0], -cap, cap, 0.01, torch.zeros(50), 1e-9)


def test_take_selects_problems():
    one = torch.ones(3, dtype=torch.float64)
    problems = Problems(torch.eye(3), -torch.eye(3), torch.eye(3), one, torch.arange(3.0))
    assert problems.take(torch.tensor([2])).cap.tolist() == [2.0]


def test_small_systems_solved_together_equal_dense_ones():
    x = torch.randn(120, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    kernel = gram("rbf", x, 0.3)
    sizes = [1, 2, 15, 16, 17, 33, 60, 64, 65, 110]
    free = torch.arange(120) < torch.tensor(sizes)[:, None]
    h = torch.logspace(-6, 0, len(sizes), dtype=torch.float64)
    right = torch.randn(len(sizes), 120, generator=torch.Generator().manual_seed(1)).double()
    u, v = solve_free(kernel, free, h, right, [True] * len(sizes))
    for row, size in enumerate(sizes):
        matrix = kernel.matrix[:size, :size] + h[row] * torch.eye(size)
        columns = torch.stack([right[row, :size], torch.ones(size)], 1)
        exact = torch.linalg.solve(matrix, columns)
        torch.testing.assert_close(u[row, :size], exact[:, 0], rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(v[row, :size], exact[:, 1], rtol=1e-6, atol=1e-6)
        assert not u[row, size:].any()
        assert not v[row, size:].any()
