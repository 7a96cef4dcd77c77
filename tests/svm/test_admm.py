"""Operator splitting against SMO, and what it leaves to others."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.svm import smo, admm as splitting
from cgtorch.svm.gram import gram
from cgtorch.svm.problems import Problems, classification, regression, violation
from cgtorch.svm.admm import split


def _rows(seed: int, n: int) -> torch.Tensor:
    return torch.randn(n, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def _slow(matrix: torch.Tensor, problems: Problems, number: int) -> torch.Tensor:
    """Values without the bias (n,) by SMO."""
    low, high = problems.lower[number], problems.upper[number]
    width, zero = float(problems.epsilon[number]), torch.zeros_like(low)
    beta, _ = smo.solve(matrix, problems.z[number], low, high, width, zero, 1e-6)
    return beta @ matrix


@given(seed=st.integers(0, 10**6), exponent=st.integers(-2, 5), regress=st.booleans())
def test_solutions_equal_those_of_smo(seed, exponent, regress):
    n = 60
    x = _rows(seed, n)
    kernel = gram("rbf", x, 2.0)
    weight = (torch.arange(n) % 3 != torch.arange(3)[:, None]).double()
    cap = torch.full((3,), 2.0**exponent, dtype=torch.float64)
    z = (2 * x[:, 0]).sin() + 0.3 * x[:, 1]
    if regress:
        problems = regression(z.expand(3, n), cap, torch.full_like(cap, 0.05), weight)
    else:
        problems = classification(torch.where(z > 0, 1.0, -1.0).double(), cap, weight)
    found = split(kernel, problems, 1e-4)
    assert bool((found.beta >= problems.lower).all())
    assert bool((found.beta <= problems.upper).all())
    for number in (found.violation <= 1e-4).nonzero().flatten().tolist():
        value = found.beta[number] @ kernel.matrix
        other = _slow(kernel.matrix, problems, number)
        assert float((value - other).abs().max()) < 0.02


def test_problems_with_many_free_coefficients_are_solved():
    x = _rows(0, 300)
    cap = torch.tensor([0.5, 8.0, 512.0], dtype=torch.float64)
    targets = (2 * x[:, 0]).sin().expand(3, 300)
    tube = torch.full_like(cap, 0.02)
    problems = regression(targets, cap, tube, torch.ones(3, 300, dtype=torch.float64))
    found = split(gram("rbf", x, 2.0), problems, 1e-3)
    assert float(found.violation.max()) <= 1e-3


def test_problems_with_few_free_coefficients_are_solved_exactly():
    x = _rows(0, 300)
    cap = torch.tensor([512.0], dtype=torch.float64)
    signs = torch.where(x[:, 0] > 0, 1.0, -1.0).double()
    problems = classification(signs, cap, torch.ones(1, 300, dtype=torch.float64))
    kernel = gram("rbf", x, 0.001)
    found = split(kernel, problems, 1e-3)
    assert float(found.violation) <= 1e-3
    wrong = found.beta[0] @ kernel.matrix - _slow(kernel.matrix, problems, 0)
    assert float((wrong - wrong.mean()).abs().max()) < 5e-3  # what is common belongs to the bias


def test_what_too_few_iterations_leave_is_said(monkeypatch):
    monkeypatch.setattr(splitting, "_ROUNDS", 0)
    x = _rows(0, 300)
    cap = torch.tensor([512.0], dtype=torch.float64)
    signs = torch.where(x[:, 0] > 0, 1.0, -1.0).double()
    problems = classification(signs, cap, torch.ones(1, 300, dtype=torch.float64))
    assert float(split(gram("rbf", x, 0.1), problems, 1e-3).violation) > 1e-3


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
