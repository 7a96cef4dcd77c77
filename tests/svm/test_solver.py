"""The solver's own promises: optimality, feasibility, and both ways of stepping agree."""

import pytest
import torch
from dual_problems import classification, regression
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from cgtorch.ground.errors import ModelError
from cgtorch.svm import solver
from cgtorch.svm.gram import Gram
from cgtorch.svm.problems import (
    Problems,
    State,
    at_zero,
    duality_gap,
    feasible,
    violation,
)
from cgtorch.svm.smo import smo_steps


def _rows(seed, n, duplicates=False, constant=False):
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(n, 3, generator=generator, dtype=torch.float64)
    if duplicates:
        x = x[torch.arange(n) % (n // 2 + 1)]
    if constant:
        x[:, 1] = 2.0
    return x, generator


def _kernel(x: Tensor, gamma: float) -> Tensor:
    return torch.exp(-gamma * torch.cdist(x, x).square())


def _one(z: Tensor, cap: float, epsilon: float) -> Problems:
    one = torch.ones(1, dtype=torch.float64)
    return regression(z[None], cap * one, epsilon * one, torch.ones(1, len(z)).double())


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
    gap = duality_gap(problems, found)
    assert torch.allclose(gap, primal - dual, atol=1e-6 * float(primal.abs().max()) + 1e-9)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(4, 60),
    exponent=st.integers(-4, 9),
    gamma=st.sampled_from([0.001, 0.1, 2.0]),
    duplicates=st.booleans(),
    constant=st.booleans(),
)
def test_classification_is_optimal(seed, n, exponent, gamma, duplicates, constant):
    x, generator = _rows(seed, n, duplicates, constant)
    noisy = x[:, 0] + 0.5 * torch.randn(n, generator=generator, dtype=torch.float64)
    signs = torch.where(noisy > noisy.median(), 1.0, -1.0).double()
    cap = torch.tensor([2.0**exponent], dtype=torch.float64)
    problems = classification(signs, cap, torch.ones(1, n, dtype=torch.float64))
    found = solver.solve(Gram(x, gamma), problems)
    _check_optimal(_kernel(x, gamma), problems, found, 1e-5)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(2, 60),
    exponent=st.integers(-4, 9),
    gamma=st.sampled_from([0.001, 0.1, 2.0]),
    epsilon=st.sampled_from([0.0, 0.01, 0.3, 100.0]),
    duplicates=st.booleans(),
)
def test_regression_is_optimal(seed, n, exponent, gamma, epsilon, duplicates):
    x, generator = _rows(seed, n, duplicates)
    z = (x[:, 0] * 2).sin() + 0.1 * torch.randn(n, generator=generator, dtype=torch.float64)
    problems = _one(z, 2.0**exponent, epsilon)
    found = solver.solve(Gram(x, gamma), problems)
    _check_optimal(_kernel(x, gamma), problems, found, 1e-5)


@given(seed=st.integers(0, 10**6), exponent=st.integers(-3, 6))
def test_held_out_rows_stay_out(seed, exponent):
    n = 50
    x, _ = _rows(seed, n)
    signs = torch.where(x[:, 0] + 0.3 * x[:, 1] > 0, 1.0, -1.0).double()
    mask = torch.arange(n)[None] % 5 != torch.arange(5)[:, None]
    cap = torch.full((5,), 2.0**exponent, dtype=torch.float64)
    problems = classification(signs, cap, mask.double())
    found = solver.solve(Gram(x, 0.3), problems)
    assert float(found.beta[~mask].abs().max()) == 0.0
    alone = solver.solve(
        Gram(x[mask[2]], 0.3),
        classification(signs[mask[2]], cap[:1], torch.ones(1, 40, dtype=torch.float64)),
    )
    value = alone.beta @ _kernel(x, 0.3)[mask[2]] + alone.bias[:, None]
    assert torch.allclose(value[0], found.product[2] + found.bias[2], atol=1e-3)


def test_large_problems_agree_with_plain_smo():
    n = 700
    x, generator = _rows(1, n)
    z = (3 * x[:, 0]).sin() + 0.2 * torch.randn(n, generator=generator, dtype=torch.float64)
    problems = _one(z, 5.0, 0.1)
    found = solver.solve(Gram(x, 0.5), problems)
    slow = smo_steps(_kernel(x, 0.5), problems, at_zero(problems), 1e-7, 10**6)
    assert float(slow.violation) <= 1e-7
    value = slow.product + slow.bias - found.product - found.bias
    assert float(value.abs().max()) < 1e-4
    assert abs(float(slow.bias - found.bias)) < 1e-4


@pytest.mark.parametrize("way", ["compiled_smo_steps", "polish"])
def test_what_exact_steps_or_compiled_ones_leave_is_solved_all_the_same(monkeypatch, way):
    x, _ = _rows(3, 60)
    problems = _one(x[:, 0], 5.0, 0.1)
    whole = solver.solve(Gram(x, 0.5), problems)
    monkeypatch.setattr(solver, way, lambda *_: None)
    found = solver.solve(Gram(x, 0.5), problems)
    _check_optimal(_kernel(x, 0.5), problems, found, 1e-4)
    assert torch.allclose(
        found.product + found.bias[:, None], whole.product + whole.bias, atol=1e-4
    )


def test_a_wrong_answer_shows_in_its_gap():
    x, _ = _rows(4, 40)
    problems = _one(x[:, 0], 5.0, 0.1)
    found = solver.solve(Gram(x, 0.5), problems)
    gap = float(duality_gap(problems, found))
    worse = State(found.beta * 0.9, found.product * 0.9, found.bias, found.violation)
    assert float(duality_gap(problems, worse)) > 100 * gap


@pytest.mark.parametrize("compiled", [True, False])
def test_what_cannot_be_solved_is_refused(monkeypatch, compiled):
    monkeypatch.setattr(solver, "_TURNS", 0)
    monkeypatch.setattr(solver, "_ENDLESS", 3)
    if not compiled:
        monkeypatch.setattr(solver, "compiled_smo_steps", lambda *_: None)
    x, generator = _rows(5, 300)
    z = torch.randn(300, generator=generator, dtype=torch.float64)
    with pytest.raises(ModelError, match="1 dual problems were not solved"):
        solver.solve(Gram(x, 0.5), _one(z, 1000.0, 0.0))


def test_plain_smo_says_what_too_few_steps_leave():
    x, _ = _rows(5, 50)
    problems = _one(x[:, 0], 10.0, 0.01)
    kernel = _kernel(x, 0.5)
    part = smo_steps(kernel, problems, at_zero(problems), 1e-9, 3)
    assert int((part.beta != 0).sum()) <= 6
    assert float(part.violation) > 1e-9
    assert float(violation(problems, part.beta, problems.z - part.product - part.bias)) > 1e-9
    whole = smo_steps(kernel, problems, part, 1e-9, 10**6)
    assert float(whole.violation) <= 1e-9


@given(seed=st.integers(0, 10**6), n=st.integers(2, 40))
def test_the_nearest_feasible_point_is_feasible_and_near(seed, n):
    generator = torch.Generator().manual_seed(seed)
    lower, upper, beta, other = torch.rand(4, 3, n, generator=generator, dtype=torch.float64)
    one = torch.ones(3, dtype=torch.float64)
    problems = Problems(beta, -lower, upper, 0 * one, one)
    beta, other = 4 * beta - 2, feasible(problems, 4 * other - 2)
    found = feasible(problems, beta)
    for point in (found, other):
        assert bool((point >= -lower).all() and (point <= upper).all())
        assert float(point.sum(1).abs().max()) < 1e-9 * n
    assert bool(((found - beta).norm(dim=1) <= (other - beta).norm(dim=1) + 1e-9).all())


def test_violation_is_the_distance_from_what_coefficients_allow():
    beta = torch.tensor([[0.0, 0.0, 0.5, 2.0, -2.0, -1.0]], dtype=torch.float64)
    residual = torch.tensor([[0.05, 0.4, 0.1, 9.0, -9.0, -0.1]], dtype=torch.float64)
    one = torch.ones(1, dtype=torch.float64)
    problems = regression(0 * beta, 2 * one, 0.1 * one, torch.ones_like(beta))
    assert float(violation(problems, beta, residual)) == 0.4 - 0.1
    residual[0, 1] = 0.0
    assert float(violation(problems, beta, residual)) == 0.0
    residual[0, 3] = 0.0
    assert float(violation(problems, beta, residual)) == 0.1


def test_take_selects_problems():
    one = torch.ones(3, dtype=torch.float64)
    problems = Problems(torch.eye(3), -torch.eye(3), torch.eye(3), one, torch.arange(3.0))
    assert problems.take(torch.tensor([2])).cap.tolist() == [2.0]
    assert float(problems.take(2).cap) == 2.0
