"""Compiled SMO against the plain one, and that neither threads nor a compiler decide a result."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tabletop import labelled, transitions
from torch import Tensor

from cgtorch.errors import DataError
from cgtorch.svm import (
    SVC,
    SVR,
    grid_problems as cells,
    warm_started_path as chains,
    compiled_smo,
    grid_search,
    smo,
)
from cgtorch.svm.warm_started_path import solve_chains
from cgtorch.svm.compiled_smo import Stand, at_zero, compiled_gram, smo_steps
from cgtorch.svm.gram import Gram, gram
from cgtorch.svm.kernels import kernel_matrix, make_kernel
from cgtorch.svm.polish import Polished
from cgtorch.svm.problems import Problems, classification, regression
from cgtorch.svm.solver import dual_objective, duality_gap
from cgtorch.native import available

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

COSTS = [0.5, 8.0, 64.0]


def _rows(seed: int, n: int, duplicates: bool = False) -> Tensor:
    x = torch.randn(n, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return x[torch.arange(n) % (n // 2 + 1)] if duplicates else x


def _gram(x: Tensor, gamma: float, kernel: str = "rbf") -> Tensor:
    found = compiled_gram(kernel, x, gamma, 2, 1.0, 1)
    assert found is not None
    return found


def _chains(
    x: Tensor, gamma: float, problems: Problems, costs: int, tolerance: float, threads: int = 1
) -> Stand:
    def exact() -> Gram:
        return gram("rbf", x, gamma)

    return solve_chains(_gram(x, gamma), exact, problems, costs, tolerance, threads)


def _problems(x: Tensor, epsilon: float | None, folds: int = 3, wave: float = 2.0) -> Problems:
    """Every cost and fold: classification without an epsilon."""
    n, count = len(x), folds * len(COSTS)
    mask = torch.arange(n) % folds != torch.arange(folds)[:, None]
    weight = mask.double().repeat(len(COSTS), 1)
    cap = torch.tensor(COSTS, dtype=torch.float64).repeat_interleave(folds)
    z = (wave * x[:, 0]).sin() + 0.3 * x[:, 1]
    if epsilon is None:
        return classification(torch.where(z > z.median(), 1.0, -1.0).double(), cap, weight)
    return regression(z.expand(count, n), cap, torch.full_like(cap, epsilon), weight)


def _violation(problems: Problems, beta: Tensor, matrix: Tensor) -> Tensor:
    """What a step up gains more than a step down costs (P,), from the definition."""
    slope = problems.z - beta @ matrix
    tube = problems.epsilon[:, None]
    up = slope - torch.where(beta >= 0, tube, -tube)
    down = slope - torch.where(beta > 0, tube, -tube)
    up = up.masked_fill(beta >= problems.upper, -torch.inf).amax(1)
    return up - down.masked_fill(beta <= problems.lower, torch.inf).amin(1)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(20, 90),
    gamma=st.sampled_from([0.01, 0.2, 2.0]),
    epsilon=st.sampled_from([None, 0.0, 0.05, 0.5]),
    duplicates=st.booleans(),
)
@settings(deadline=None, max_examples=60)
def test_solutions_are_those_of_plain_smo(seed, n, gamma, epsilon, duplicates):
    x = _rows(seed, n, duplicates)
    problems = _problems(x, epsilon)
    exact = kernel_matrix(make_kernel("rbf", gamma), x)
    found = _chains(x, gamma, problems, len(COSTS), 1e-4)
    solved = found.violation <= 1e-4
    assert bool(solved.all())
    assert bool((found.beta >= problems.lower).all())
    assert bool((found.beta <= problems.upper).all())
    assert float((found.beta.sum(1).abs() / problems.cap).max()) <= 1e-9
    assert float(_violation(problems, found.beta, exact).max()) <= 2e-4
    torch.testing.assert_close(found.product, found.beta @ exact, atol=1e-4, rtol=0)
    objective = dual_objective(problems, found.beta, found.product)
    for k in range(len(objective)):
        low, high, width = problems.lower[k], problems.upper[k], float(problems.epsilon[k])
        beta, bias = smo.solve(exact, problems.z[k], low, high, width, 0 * low, 1e-6)
        best = float(dual_objective(problems.take(torch.tensor([k])), beta[None], beta @ exact))
        assert float(objective[k]) == pytest.approx(best, rel=1e-3, abs=1e-3)
        value = found.product[k] + found.bias[k] - beta @ exact - bias
        if bool(((beta > low) & (beta < high) & (beta != 0)).any()):
            assert float(value.abs().max()) < 0.05


@pytest.mark.parametrize("epsilon", [None, 0.02])
def test_problems_larger_than_a_set_are_solved(epsilon):
    x = _rows(1, 1500)
    problems = _problems(x, epsilon, folds=2, wave=9.0)
    found = _chains(x, 0.5, problems, len(COSTS), 1e-3, 2)
    assert float(found.violation.max()) < 1e-3
    free = (found.beta > problems.lower) & (found.beta < problems.upper) & (found.beta != 0)
    assert int(free.sum(1).max()) > 400
    exact = kernel_matrix(make_kernel("rbf", 0.5), x)
    assert float(_violation(problems, found.beta, exact).max()) < 1.1e-3
    gap = duality_gap(problems, found.beta, found.bias, found.product)
    assert float((gap / dual_objective(problems, found.beta, found.product).abs()).max()) < 0.01


def test_threads_change_nothing():
    x = _rows(2, 301)
    problems = _problems(x, 0.05, folds=5)
    found = [_chains(x, 0.3, problems, len(COSTS), 1e-3, threads) for threads in (1, 2, 7)]
    for other in found[1:]:
        for name, value in vars(other).items():
            assert torch.equal(value, getattr(found[0], name))
    grams = [compiled_gram("rbf", x, 0.3, 3, 0.0, threads) for threads in (1, 3)]
    assert torch.equal(*(g[:, :301] for g in grams if g is not None))


def test_a_cost_that_binds_nothing_keeps_the_solution():
    x = _rows(3, 120)
    cap = torch.tensor([100.0, 2e3], dtype=torch.float64)
    z = (2 * x[:, 0]).sin()
    problems = regression(z.expand(2, 120), cap, torch.full_like(cap, 0.1), torch.ones(2, 120))
    loose = compiled_smo._GAP
    found = _chains(x, 2.0, problems, 2, 1e-3)
    assert float(found.beta.abs().max()) < 100
    torch.testing.assert_close(found.product[0], found.product[1], atol=2e-3, rtol=0)
    gap = duality_gap(problems, found.beta, found.bias, found.product)
    assert float((gap / dual_objective(problems, found.beta, found.product).abs()).max()) <= (
        1.1 * loose
    )


def test_what_takes_too_long_is_said_and_goes_on_from_there():
    x = _rows(4, 200)
    problems = _problems(x, 0.01)
    matrix, exact = _gram(x, 0.05), kernel_matrix(make_kernel("rbf", 0.05), x)
    found = smo_steps(matrix, problems, at_zero(problems), 1e-3, 1.0, 1)
    assert float(found.violation.max()) > 1e-3
    wrong = _violation(problems, found.beta, exact)
    torch.testing.assert_close(found.violation, wrong, rtol=0, atol=1e-3)
    on = smo_steps(matrix, problems, found, 1e-3, 1e9, 1)
    assert float(_violation(problems, on.beta, exact).max()) < 1.1e-3


def test_exact_steps_end_what_would_take_too_long(monkeypatch):
    monkeypatch.setattr(chains, "_WORTH", (0.0, 1e6))
    ended = []

    def polish(*given: Tensor) -> Polished:
        ended.append(chains_polish(*given))
        return ended[-1]

    chains_polish = chains.polish
    monkeypatch.setattr(chains, "polish", polish)
    x = _rows(4, 400)
    problems = _problems(x, 0.01)
    found = _chains(x, 0.05, problems, len(COSTS), 1e-3)
    assert any(bool(each.solved.any()) for each in ended)
    solved = found.violation <= 1e-3
    exact = kernel_matrix(make_kernel("rbf", 0.05), x)
    assert float(_violation(problems, found.beta, exact)[solved].max()) < 2.1e-3


@pytest.mark.parametrize("n", [1, 15, 16, 17, 100])
@pytest.mark.parametrize("kernel", ["rbf", "linear", "poly"])
def test_kernel_matrices_are_those_of_torch(n, kernel):
    x = 3 * _rows(5, n) + 100
    exact = kernel_matrix(make_kernel(kernel, 0.3, 2, 1.0), x)
    found = _gram(x, 0.3, kernel)
    assert found.shape == (n, n + -n % 16)
    assert bool(torch.isfinite(found).all())
    scale = float(exact.abs().max())
    torch.testing.assert_close(found[:, :n].double(), exact, atol=1e-7 * scale, rtol=0)


def test_kernels_that_are_not_finite_are_refused():
    with pytest.raises(DataError, match="non-finite"):
        compiled_gram("rbf", torch.tensor([[1e200], [-1e200], [1e300]]).double(), 1.0, 3, 0.0, 1)


@pytest.mark.parametrize("classifier", [True, False])
def test_grids_agree_with_and_without_a_compiler(monkeypatch, classifier):
    if classifier:
        x, y = labelled(200)
        model = SVC()
    else:
        p, u, q = transitions(150)
        x, y, model = np.concatenate([p, u], 1), q[:, [0, 4]] / q[:, [0, 4]].std(0), SVR()
    x = (x - x.mean(0)) / np.where(x.std(0) > 0, x.std(0), 1)
    grid = {"C": [0.5, 16.0, 256.0], "gamma": [0.02, 0.2, 2.0]}
    compiled = grid_search(model, x, y, **grid)
    monkeypatch.setattr(compiled_smo, "function", lambda *_: None)
    plain = grid_search(model, x, y, folds=compiled.folds, **grid)
    assert bool(compiled.direct.all())
    assert bool(plain.direct.all())
    np.testing.assert_allclose(compiled.held_out, plain.held_out, atol=5e-3, rtol=1e-3)
    np.testing.assert_allclose(compiled.mean, plain.mean, atol=1e-3)


def test_where_everything_is_solved_no_other_method_is_asked(monkeypatch):
    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(cells, "split", never)
    monkeypatch.setattr(cells, "gram", never)
    x, y = labelled(120)
    found = grid_search(SVC(), x, y, C=[1.0, 8.0], gamma=[0.5, 2.0])
    assert float(found.gap.max()) < 0.01
