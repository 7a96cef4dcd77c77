"""Full Newton steps from nearly right statuses against SMO, and when they give up."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.svm import smo
from cgtorch.svm.gram import Gram, gram
from cgtorch.svm.polish import polish
from cgtorch.svm.problems import Problems, classification, regression, violation


def _exact(kernel: Gram, problems: Problems) -> tuple[torch.Tensor, torch.Tensor]:
    """Coefficients and biases by SMO."""
    found = [
        smo.solve(kernel.matrix, z, low, high, float(width), torch.zeros_like(low), 1e-7)
        for z, low, high, width in zip(
            problems.z, problems.lower, problems.upper, problems.epsilon, strict=True
        )
    ]
    beta, bias = zip(*found, strict=True)
    return torch.stack(beta), torch.stack(bias)


def _problems(seed: int, cap: float, regress: bool) -> tuple[Gram, Problems]:
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(60, 4, dtype=torch.float64, generator=generator)
    z = (2 * x[:, 0]).sin() + 0.3 * x[:, 1]
    weight = (torch.arange(60) % 3 != torch.arange(3)[:, None]).double()
    caps = torch.full((3,), cap, dtype=torch.float64)
    if regress:
        return gram("rbf", x, 0.5), regression(
            z.expand(3, -1), caps, torch.full_like(caps, 0.05), weight
        )
    return gram("rbf", x, 0.5), classification(torch.where(z > 0, 1.0, -1.0).double(), caps, weight)


@given(seed=st.integers(0, 10**6), exponent=st.integers(-2, 7), regress=st.booleans())
def test_a_rough_solution_becomes_an_optimal_one(seed: int, exponent: int, regress: bool) -> None:
    kernel, problems = _problems(seed, 2.0**exponent, regress)
    beta, bias = _exact(kernel, problems)
    rough = torch.where(beta.abs() < 0.02 * problems.cap[:, None], 0.0, beta)
    found = polish(kernel, problems, rough, bias, 1e-3)
    for number in found.solved.nonzero().flatten().tolist():
        one = problems.take(torch.tensor([number]))
        got = found.beta[number]
        assert bool((got >= one.lower[0]).all() and (got <= one.upper[0]).all())
        assert abs(float(got.sum())) <= 1e-5 * float(one.cap)
        value = got @ kernel.matrix
        residual = one.z - value - found.bias[number]
        assert float(violation(one, got[None], residual)) <= 1e-3
        best = beta[number]
        objectives = [
            float(0.5 * b @ kernel.matrix @ b - one.z[0] @ b + one.epsilon * b.abs().sum())
            for b in (got, best)
        ]
        assert objectives[0] <= objectives[1] + 1e-3 * float(best.abs().sum()) + 1e-9


def test_the_solution_itself_is_kept() -> None:
    kernel, problems = _problems(0, 4.0, False)
    beta, bias = _exact(kernel, problems)
    found = polish(kernel, problems, beta, bias, 1e-3)
    assert bool(found.solved.all())
    assert float((found.beta - beta).abs().max()) < 0.05
    assert float((found.bias - bias).abs().max()) < 5e-3


def test_what_is_given_up_comes_back_as_it_was() -> None:
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(300, 4, dtype=torch.float64, generator=generator)
    signs = torch.where(torch.rand(300, generator=generator) > 0.5, 1.0, -1.0).double()
    cap = torch.tensor([1000.0], dtype=torch.float64)
    problems = classification(signs, cap, torch.ones(1, 300, dtype=torch.float64))
    start = torch.where(signs > 0, problems.upper, 0.0)
    bias = torch.zeros(1, dtype=torch.float64)
    found = polish(gram("rbf", x, 0.01), problems, start, bias, 1e-3)
    assert not bool(found.solved.any())
    assert torch.equal(found.beta, start)
    assert torch.equal(found.bias, bias)
