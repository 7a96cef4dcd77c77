"""Compiled SMO against the plain one, and that neither threads nor a compiler decide a result."""

import numpy as np
import pytest
import torch
from dual_problems import classification, regression
from hypothesis import given, settings
from hypothesis import strategies as st
from stand_in import labelled, transitions
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.native import available
from cgtorch.svm import SVC, SVR, grid_search, smo, solver
from cgtorch.svm.gram import Gram, rbf
from cgtorch.svm.grid_search import scaled_start
from cgtorch.svm.problems import (
    Problems,
    State,
    at_zero,
    dual_objective,
    duality_gap,
)
from cgtorch.svm.smo import GAP, compiled_smo_steps, smo_steps
from cgtorch.svm.solver import solve

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

COSTS = [0.5, 8.0, 64.0]


def _rows(seed: int, n: int, duplicates: bool = False) -> Tensor:
    x = torch.randn(n, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return x[torch.arange(n) % (n // 2 + 1)] if duplicates else x


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


def _rising(gram: Gram, problems: Problems, tolerance: float) -> State:
    """The problems of each cost from the solutions for the cost before."""
    found: list[State] = []
    blocks = [problems.take(index) for index in torch.arange(len(problems.z)).chunk(len(COSTS))]
    for number, block in enumerate(blocks):
        last = (blocks[number - 1], found[-1]) if number else None
        start = scaled_start(*last, block) if last else None
        found.append(solve(gram, block, start, tolerance))
    return State(
        *(torch.cat(part) for part in zip(*(vars(f).values() for f in found), strict=True))
    )


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
    exact = rbf(x, x, gamma)
    found = _rising(Gram(x, gamma), problems, 1e-4)
    assert bool((found.violation <= 1e-4).all())
    assert bool((found.beta >= problems.lower).all())
    assert bool((found.beta <= problems.upper).all())
    assert float((found.beta.sum(1).abs() / problems.cap).max()) <= 1e-9
    assert float(_violation(problems, found.beta, exact).max()) <= 2e-4
    torch.testing.assert_close(found.product, found.beta @ exact, atol=1e-4, rtol=0)
    slow = smo_steps(exact, problems, at_zero(problems), 1e-6, 10**7)
    assert float(slow.violation.max()) <= 1e-6
    objectives = [dual_objective(problems, state) for state in (found, slow)]
    torch.testing.assert_close(*objectives, rtol=1e-3, atol=1e-3)
    value = found.product + found.bias[:, None] - slow.product - slow.bias[:, None]
    free = (slow.beta > problems.lower) & (slow.beta < problems.upper) & (slow.beta != 0)
    assert float((value * free.any(1, keepdim=True)).abs().max()) < 0.05


@pytest.mark.parametrize("epsilon", [None, 0.02])
def test_problems_larger_than_a_set_are_solved(epsilon):
    x = _rows(1, 1500)
    problems = _problems(x, epsilon, folds=2, wave=9.0)
    found = _rising(Gram(x, 0.5, threads=2), problems, 1e-3)
    assert float(found.violation.max()) < 1e-3
    free = (found.beta > problems.lower) & (found.beta < problems.upper) & (found.beta != 0)
    assert int(free.sum(1).max()) > 400
    exact = rbf(x, x, 0.5)
    assert float(_violation(problems, found.beta, exact).max()) < 1.1e-3
    gap = duality_gap(problems, found)
    assert float((gap / dual_objective(problems, found).abs()).max()) < 0.01


def test_threads_change_nothing():
    x = _rows(2, 301)
    problems = _problems(x, 0.05, folds=5)
    grams = [Gram(x, 0.3, threads=threads) for threads in (1, 2, 7)]
    found = [_rising(gram, problems, 1e-3) for gram in grams]
    for other in found[1:]:
        for name, value in vars(other).items():
            assert torch.equal(value, getattr(found[0], name))
    assert torch.equal(grams[0].single[:, :301], grams[2].single[:, :301])


def test_a_cost_that_binds_nothing_keeps_the_solution():
    x = _rows(3, 120)
    cap = torch.tensor([100.0, 2e3], dtype=torch.float64)
    z, tube = (2 * x[:, 0]).sin(), torch.full((1,), 0.1).double()
    gram, every = Gram(x, 2.0), torch.ones(1, 120, dtype=torch.float64)
    first, second = (regression(z[None], cap[i : i + 1], tube, every) for i in range(2))
    found = solve(gram, first, None, 1e-3)
    assert float(found.beta.abs().max()) < 100
    again = solve(gram, second, scaled_start(first, found, second), 1e-3)
    torch.testing.assert_close(found.product, again.product, atol=2e-3, rtol=0)
    gap = duality_gap(second, again) / dual_objective(second, again).abs()
    assert float(gap) <= 1.1 * GAP


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_what_takes_too_long_is_said_and_goes_on_from_there(kind):
    x = _rows(4, 200)
    problems, gram = _problems(x, 0.01), Gram(x, 0.05)
    matrix = gram.single if kind == torch.float32 else gram.double
    found = compiled_smo_steps(matrix, problems, at_zero(problems), 1e-3, 1.0, 1)
    assert found is not None
    assert float(found.violation.max()) > 1e-3
    wrong = _violation(problems, found.beta, gram.matrix)
    torch.testing.assert_close(found.violation, wrong, rtol=0, atol=1e-3)
    on = compiled_smo_steps(matrix, problems, found, 1e-3, 1e9, 1)
    assert on is not None
    assert float(_violation(problems, on.beta, gram.matrix).max()) < 1.1e-3


def test_double_precision_goes_as_far_as_is_asked():
    x = _rows(4, 200)
    problems, gram = _problems(x, 0.01), Gram(x, 0.5)
    found = compiled_smo_steps(gram.double, problems, at_zero(problems), 1e-9, 1e12, 1)
    assert found is not None
    assert float(_violation(problems, found.beta, gram.matrix).max()) < 1.1e-9


def test_exact_steps_end_what_would_take_too_long(monkeypatch):
    monkeypatch.setattr(solver, "_WORTH", (0.0, 1e6))
    ended, polish = [], solver.polish

    def watched(*given):
        ended.append(polish(*given))
        return ended[-1]

    monkeypatch.setattr(solver, "polish", watched)
    x = _rows(4, 400)
    problems = _problems(x, 0.01)
    found = _rising(Gram(x, 0.05), problems, 1e-3)
    assert any(each is not None for each in ended)
    exact = rbf(x, x, 0.05)
    assert float(_violation(problems, found.beta, exact).max()) < 2.1e-3


@pytest.mark.parametrize("n", [1, 15, 16, 17, 100])
def test_kernel_matrices_are_those_of_torch(n):
    x = 3 * _rows(5, n) + 100
    exact, gram = rbf(x, x, 0.3), Gram(x, 0.3)
    assert gram.single.shape == (n, n + -n % 16)
    assert gram.double.shape == (n, n + -n % 8)
    assert bool(torch.isfinite(gram.single).all())
    assert torch.equal(gram.matrix, exact)
    scale = float(exact.abs().max())
    torch.testing.assert_close(gram.single[:, :n].double(), exact, atol=1e-7 * scale, rtol=0)


def test_kernels_that_are_not_finite_are_refused():
    rows = torch.tensor([[1e200], [-1e200], [1e300]]).double()
    with pytest.raises(DataError, match="non-finite"):
        _ = Gram(rows, 1.0).single


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
    monkeypatch.setattr(smo, "function", lambda *_: None)
    plain = grid_search(model, x, y, folds=compiled.folds, **grid)
    np.testing.assert_allclose(compiled.held_out, plain.held_out, atol=5e-3, rtol=1e-3)
    np.testing.assert_allclose(compiled.mean, plain.mean, atol=1e-3)


def test_where_everything_is_solved_no_exact_steps_are_asked(monkeypatch):
    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(solver, "polish", never)
    monkeypatch.setattr(solver, "smo_steps", never)
    x, y = labelled(120)
    found = grid_search(SVC(), x, y, C=[1.0, 8.0], gamma=[0.5, 2.0])
    assert float(found.gap.max()) < 0.01
