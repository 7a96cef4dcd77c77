"""Full Newton steps from nearly right statuses against SMO, and when they give up."""

import torch
from dual_problems import classification, regression
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from cgtorch.svm.gram import Gram
from cgtorch.svm.polish import polish
from cgtorch.svm.problems import (
    Problems,
    State,
    at_zero,
    dual_objective,
    violation,
)
from cgtorch.svm.smo import smo_steps


def _state(kernel: Tensor, beta: Tensor, bias: Tensor) -> State:
    return State(beta, beta @ kernel, bias, torch.full_like(bias, torch.inf))


def _problems(seed: int, cap: float, regress: bool) -> tuple[Tensor, Problems]:
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(60, 4, dtype=torch.float64, generator=generator)
    z = (2 * x[:, 0]).sin() + 0.3 * x[:, 1]
    weight = (torch.arange(60) % 3 != torch.arange(3)[:, None]).double()
    caps, kernel = torch.full((3,), cap, dtype=torch.float64), Gram(x, 0.5).matrix
    if regress:
        return kernel, regression(z.expand(3, -1), caps, torch.full_like(caps, 0.05), weight)
    return kernel, classification(torch.where(z > 0, 1.0, -1.0).double(), caps, weight)


@given(seed=st.integers(0, 10**6), exponent=st.integers(-2, 7), regress=st.booleans())
def test_a_rough_solution_becomes_an_optimal_one(seed: int, exponent: int, regress: bool) -> None:
    kernel, problems = _problems(seed, 2.0**exponent, regress)
    best = smo_steps(kernel, problems, at_zero(problems), 1e-7, 10**6)
    rough = torch.where(best.beta.abs() < 0.02 * problems.cap[:, None], 0.0, best.beta)
    start = _state(kernel, rough, best.bias)
    for number in range(3):
        one = problems.take(number)
        got = polish(kernel, one, start.take(number), 1e-3)
        if got is None:
            continue
        assert bool((got.beta >= one.lower).all() and (got.beta <= one.upper).all())
        assert abs(float(got.beta.sum())) <= 1e-5 * float(one.cap)
        torch.testing.assert_close(got.product, got.beta @ kernel, atol=1e-8, rtol=1e-8)
        residual = one.z - got.beta @ kernel - got.bias
        assert float(violation(one, got.beta, residual)) <= 1e-3
        at = problems.take(torch.tensor([number]))
        states = (
            State(*(value[None] for value in vars(got).values())),
            best.take(torch.tensor([number])),
        )
        mine, other = (float(dual_objective(at, state)) for state in states)
        assert mine <= other + 1e-3 * float(best.beta[number].abs().sum()) + 1e-9


def test_the_solution_itself_is_kept() -> None:
    kernel, problems = _problems(0, 4.0, False)
    best = smo_steps(kernel, problems, at_zero(problems), 1e-7, 10**6)
    for number in range(3):
        found = polish(kernel, problems.take(number), best.take(number), 1e-3)
        assert found is not None
        assert float((found.beta - best.beta[number]).abs().max()) < 0.05
        assert float((found.bias - best.bias[number]).abs()) < 5e-3


def test_what_is_hopeless_is_given_up_and_left_as_it_was() -> None:
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(300, 4, dtype=torch.float64, generator=generator)
    signs = torch.where(torch.rand(300, generator=generator) > 0.5, 1.0, -1.0).double()
    cap = torch.tensor([1000.0], dtype=torch.float64)
    problems = classification(signs, cap, torch.ones(1, 300, dtype=torch.float64))
    kernel = Gram(x, 0.01).matrix
    beta = torch.where(signs > 0, problems.upper, 0.0)
    start = _state(kernel, beta, torch.zeros(1, dtype=torch.float64)).take(0)
    before = start.beta.clone()
    assert polish(kernel, problems.take(0), start, 1e-3) is None
    assert torch.equal(start.beta, before)


def test_many_free_and_few_free_coefficients_become_exact() -> None:
    x = torch.randn(300, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    one, every = torch.ones(1, dtype=torch.float64), torch.ones(1, 300, dtype=torch.float64)
    cases = (
        (2.0, regression((2 * x[:, :1]).sin().T, 512 * one, 0.02 * one, every)),
        (0.001, classification(torch.where(x[:, 0] > 0, 1.0, -1.0).double(), 512 * one, every)),
    )
    for gamma, problems in cases:
        kernel = Gram(x, gamma).matrix
        rough = smo_steps(kernel, problems, at_zero(problems), 1e-2, 10**5)
        found = polish(kernel, problems.take(0), rough.take(0), 1e-7)
        assert found is not None
        residual = problems.z[0] - found.beta @ kernel - found.bias
        assert float(violation(problems.take(0), found.beta, residual)) <= 2e-7
