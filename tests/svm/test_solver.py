"""The solver's promises: optimality and feasibility, however it steps and on how many threads."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from dual_problems import assert_feasible, dual_problems, ones, rows, wrong
from hypothesis import given, settings
from hypothesis import strategies as st
from stand_in import labelled, transitions
from support import seeded
from torch import Tensor

from cgtorch.ground.errors import ModelError
from cgtorch.native import available
from cgtorch.svm import SVC, SVR, grid_search, smo, solver
from cgtorch.svm.grid_search import scaled_start
from cgtorch.svm.problems import (
    Problems,
    State,
    at_zero,
    dual_objective,
    duality_gap,
    feasible,
    violation,
)
from cgtorch.svm.rbf import Gram
from cgtorch.svm.smo import GAP, compiled_smo_steps, smo_steps
from cgtorch.svm.solver import polish, solve

compiled = pytest.mark.skipif(not available(), reason="there is no C compiler")
COSTS = torch.tensor([0.5, 8.0, 64.0], dtype=torch.float64)


def wave(x: Tensor, frequency: float = 2.0) -> Tensor:
    """Targets (n,), of which half are positive."""
    z = (frequency * x[:, 0]).sin() + 0.3 * x[:, 1]
    return z - z.median()


def noise(n: int) -> Tensor:
    return torch.randn(n, generator=seeded(7), dtype=torch.float64)


def each(problems: Problems, tolerance: float) -> Tensor:
    """The same tolerance for each problem."""
    return torch.full_like(problems.cap, tolerance)


def all_folds(x: Tensor, epsilon: float | None, folds: int = 3, frequency: float = 2.0) -> Problems:
    """A problem for every cost and fold."""
    mask = torch.arange(len(x)) % folds != torch.arange(folds)[:, None]
    cap, weight = COSTS.repeat_interleave(folds), mask.double().repeat(len(COSTS), 1)
    return dual_problems(wave(x, frequency), cap, epsilon, weight)


def rising(gram: Gram, problems: Problems, tolerance: float) -> State:
    """The solutions for each cost from those for the cost before."""
    blocks = [problems.take(index) for index in torch.arange(len(problems.z)).chunk(len(COSTS))]
    found = [solve(gram, blocks[0], None, tolerance)]
    for before, block in pairwise(blocks):
        found.append(solve(gram, block, scaled_start(before, found[-1], block), tolerance))
    every = zip(*(vars(f).values() for f in found), strict=True)
    return State(*(torch.cat(part) for part in every))


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(4, 60),
    exponent=st.integers(-4, 9),
    gamma=st.sampled_from([0.001, 0.1, 2.0]),
    epsilon=st.sampled_from([None, 0.0, 0.01, 0.3, 100.0]),
    duplicates=st.booleans(),
    constant=st.booleans(),
)
@settings(max_examples=30)
def test_solutions_are_optimal(seed, n, exponent, gamma, epsilon, duplicates, constant):
    """KKT conditions within what the gap allows, straight from the definition."""
    x = rows(seed, n, duplicates)
    if constant:
        x[:, 1] = 2.0
    z = wave(x) + 0.1 * noise(n)
    problems = dual_problems(z - z.median(), 2.0**exponent, epsilon)
    kernel = torch.exp(-gamma * torch.cdist(x, x).square())
    found = solve(Gram(x, gamma), problems)
    assert_feasible(problems, found)
    beta, width = found.beta, problems.epsilon[:, None]
    assert torch.allclose(found.product, beta @ kernel)
    residual = problems.z - beta @ kernel - found.bias[:, None]
    loss = problems.upper * (residual - width).clamp_min(0)
    loss = loss - problems.lower * (-residual - width).clamp_min(0)
    square = 0.5 * (beta * (beta @ kernel)).sum(1)
    primal = square + loss.sum(1)
    dual = (problems.z * beta - width * beta.abs()).sum(1) - square
    assert bool((primal - dual <= 1e-5 * (primal.abs() + 1e-9)).all())
    gap = duality_gap(problems, found)
    assert torch.allclose(gap, primal - dual, atol=1e-6 * float(primal.abs().max()) + 1e-9)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(20, 90),
    gamma=st.sampled_from([0.01, 0.2, 2.0]),
    epsilon=st.sampled_from([None, 0.0, 0.05, 0.5]),
    duplicates=st.booleans(),
)
@settings(max_examples=20)
def test_solutions_are_those_of_plain_smo(seed, n, gamma, epsilon, duplicates):
    x = rows(seed, n, duplicates)
    problems, gram = all_folds(x, epsilon), Gram(x, gamma)
    found = rising(gram, problems, 1e-4)
    assert bool((found.violation <= 1e-4).all())
    assert_feasible(problems, found)
    assert float(wrong(problems, found.beta, gram.matrix).max()) <= 2e-4
    torch.testing.assert_close(found.product, found.beta @ gram.matrix, atol=1e-4, rtol=0)
    slow = smo_steps(gram.matrix, problems, at_zero(problems), each(problems, 1e-6), 10**7)
    assert float(slow.violation.max()) <= 1e-6
    objectives = [dual_objective(problems, state) for state in (found, slow)]
    torch.testing.assert_close(*objectives, rtol=1e-3, atol=1e-3)
    value = found.product + found.bias[:, None] - slow.product - slow.bias[:, None]
    free = (slow.beta > problems.lower) & (slow.beta < problems.upper) & (slow.beta != 0)
    assert float((value * free.any(1, keepdim=True)).abs().max()) < 0.05


@given(seed=st.integers(0, 10**6), exponent=st.integers(-3, 6))
@settings(max_examples=20)
def test_held_out_rows_stay_out(seed, exponent):
    x, gamma = rows(seed, 50), 0.3
    mask = torch.arange(50)[None] % 5 != torch.arange(5)[:, None]
    z, cap = wave(x), 2.0**exponent * ones(5)
    gram = Gram(x, gamma)
    found = solve(gram, dual_problems(z, cap, None, mask.double()))
    assert float(found.beta[~mask].abs().max()) == 0.0
    alone = solve(Gram(x[mask[2]], gamma), dual_problems(z[mask[2]], cap[:1]))
    value = alone.beta @ gram.matrix[mask[2]] + alone.bias[:, None]
    assert torch.allclose(value[0], found.product[2] + found.bias[2], atol=1e-3)


@compiled
@pytest.mark.parametrize("epsilon", [None, 0.02])
def test_problems_larger_than_a_set_are_solved(epsilon):
    x = rows(1, 1500)
    problems, gram = all_folds(x, epsilon, folds=2, frequency=9.0), Gram(x, 0.5, 2)
    found = rising(gram, problems, 1e-3)
    assert float(found.violation.max()) < 1e-3
    free = (found.beta > problems.lower) & (found.beta < problems.upper) & (found.beta != 0)
    assert int(free.sum(1).max()) > 400
    assert float(wrong(problems, found.beta, gram.matrix).max()) < 1.1e-3
    gap = duality_gap(problems, found)
    assert float((gap / dual_objective(problems, found).abs()).max()) < 0.01


def test_threads_change_nothing():
    x = rows(2, 301)
    problems = all_folds(x, 0.05, folds=5)
    grams = [Gram(x, 0.3, threads) for threads in (1, 2, 7)]
    found = [rising(gram, problems, 1e-3) for gram in grams]
    for other in found[1:]:
        for name, value in vars(other).items():
            assert torch.equal(value, getattr(found[0], name))
    assert torch.equal(grams[0].single[:, :301], grams[2].single[:, :301])


def test_a_cost_that_binds_nothing_keeps_the_solution():
    x = rows(3, 120)
    gram, z = Gram(x, 2.0), (2 * x[:, 0]).sin()
    first, second = (dual_problems(z, cap, 0.1) for cap in (100.0, 2e3))
    found = solve(gram, first, None, 1e-3)
    assert float(found.beta.abs().max()) < 100
    again = solve(gram, second, scaled_start(first, found, second), 1e-3)
    torch.testing.assert_close(found.product, again.product, atol=2e-3, rtol=0)
    assert float(duality_gap(second, again) / dual_objective(second, again).abs()) <= 1.1 * GAP


@compiled
@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_what_takes_too_long_is_said_and_goes_on_from_there(kind):
    x = rows(4, 200)
    problems, gram = all_folds(x, 0.01), Gram(x, 0.05)
    matrix = gram.single if kind == torch.float32 else gram.double
    found = compiled_smo_steps(matrix, problems, at_zero(problems), each(problems, 1e-3), 1.0, 1)
    assert float(found.violation.max()) > 1e-3
    now = wrong(problems, found.beta, gram.matrix)
    torch.testing.assert_close(found.violation, now, rtol=0, atol=1e-3)
    on = compiled_smo_steps(matrix, problems, found, each(problems, 1e-3), 1e9, 1)
    assert float(wrong(problems, on.beta, gram.matrix).max()) < 1.1e-3


@compiled
def test_double_precision_goes_as_far_as_is_asked():
    x = rows(4, 200)
    problems, gram = all_folds(x, 0.01), Gram(x, 0.5)
    found = compiled_smo_steps(
        gram.double, problems, at_zero(problems), each(problems, 1e-9), 1e12, 1
    )
    assert float(wrong(problems, found.beta, gram.matrix).max()) < 1.1e-9


def test_plain_smo_says_what_too_few_steps_leave():
    x = rows(5, 50)
    problems, kernel = dual_problems(x[:, 0], 10.0, 0.01), Gram(x, 0.5).matrix
    part = smo_steps(kernel, problems, at_zero(problems), each(problems, 1e-9), 3)
    assert int((part.beta != 0).sum()) <= 6
    assert float(part.violation) > 1e-9
    assert float(violation(problems, part.beta, problems.z - part.product - part.bias)) > 1e-9
    assert float(smo_steps(kernel, problems, part, each(problems, 1e-9), 10**6).violation) <= 1e-9


def test_exact_steps_end_what_would_take_too_long(monkeypatch):
    monkeypatch.setattr(solver, "_WORTH", (0.0, 1e6))
    ended = []
    monkeypatch.setattr(solver, "polish", lambda *given: ended.append(polish(*given)) or ended[-1])
    x = rows(4, 400)
    problems, gram = all_folds(x, 0.01), Gram(x, 0.05)
    found = rising(gram, problems, 1e-3)
    assert any(each is not None for each in ended)
    assert float(wrong(problems, found.beta, gram.matrix).max()) < 2.1e-3


@pytest.mark.parametrize("way", ["compiled_smo_steps", "polish"])
def test_what_exact_steps_or_compiled_ones_leave_is_solved_all_the_same(monkeypatch, way):
    x = rows(3, 60)
    problems, gram = dual_problems(x[:, 0], 5.0, 0.1), Gram(x, 0.5)
    whole = solve(gram, problems)
    monkeypatch.setattr(solver, way, lambda *_: None)
    monkeypatch.setattr(solver, "_WORTH", (0.0, 0.0))
    found = solve(gram, problems)
    assert_feasible(problems, found)
    assert torch.allclose(found.product + found.bias, whole.product + whole.bias, atol=1e-4)


def test_where_everything_is_solved_no_exact_steps_are_asked(monkeypatch):
    for name in ("polish", "smo_steps") if available() else ():
        monkeypatch.delattr(solver, name)
    x, y = labelled(120)
    assert float(grid_search(SVC(), x, y, C=[1.0, 8.0], gamma=[0.5, 2.0]).gap.max()) < 0.01


@pytest.mark.parametrize("classifier", [True, False])
def test_grids_agree_with_and_without_a_compiler(monkeypatch, classifier):
    if classifier:
        (x, y), model = labelled(150), SVC()
    else:
        p, u, q = transitions(100)
        x, y, model = np.concatenate([p, u], 1), q[:, [0, 4]] / q[:, [0, 4]].std(0), SVR()
    x = (x - x.mean(0)) / np.where(x.std(0) > 0, x.std(0), 1)
    grid = {"C": [0.5, 16.0, 256.0], "gamma": [0.2, 2.0]}
    found = grid_search(model, x, y, **grid)
    monkeypatch.setattr(smo, "function", lambda *_: None)
    plain = grid_search(model, x, y, folds=found.folds, **grid)
    np.testing.assert_allclose(found.held_out, plain.held_out, atol=5e-3, rtol=1e-3)
    np.testing.assert_allclose(found.mean, plain.mean, atol=1e-3)


def test_a_wrong_answer_shows_in_its_gap():
    x = rows(4, 40)
    problems = dual_problems(x[:, 0], 5.0, 0.1)
    found = solve(Gram(x, 0.5), problems)
    worse = State(found.beta * 0.9, found.product * 0.9, found.bias, found.violation)
    assert float(duality_gap(problems, worse)) > 100 * float(duality_gap(problems, found))


@pytest.mark.parametrize("steps", ["compiled", "plain"])
def test_what_cannot_be_solved_is_refused(monkeypatch, steps):
    monkeypatch.setattr(solver, "_TURNS", 0)
    monkeypatch.setattr(solver, "_ENDLESS", 3)
    if steps == "plain":
        monkeypatch.setattr(solver, "compiled_smo_steps", lambda *_: None)
    with pytest.raises(ModelError, match="1 dual problems were not solved"):
        solve(Gram(rows(5, 300), 0.5), dual_problems(noise(300), 1000.0, 0.0))


@given(seed=st.integers(0, 10**6), n=st.integers(2, 40))
def test_the_nearest_feasible_point_is_feasible_and_near(seed, n):
    lower, upper, beta, other = torch.rand(4, 3, n, generator=seeded(seed), dtype=torch.float64)
    problems = Problems(beta, -lower, upper, 0 * ones(3), ones(3))
    beta, other = 4 * beta - 2, feasible(problems, 4 * other - 2)
    found = feasible(problems, beta)
    for point in (found, other):
        assert bool((point >= -lower).all() and (point <= upper).all())
        assert float(point.sum(1).abs().max()) < 1e-9 * n
    assert bool(((found - beta).norm(dim=1) <= (other - beta).norm(dim=1) + 1e-9).all())


def test_violation_is_the_distance_from_what_coefficients_allow():
    beta = torch.tensor([[0.0, 0.0, 0.5, 2.0, -2.0, -1.0]], dtype=torch.float64)
    residual = torch.tensor([[0.05, 0.4, 0.1, 9.0, -9.0, -0.1]], dtype=torch.float64)
    problems = dual_problems(0 * beta[0], 2.0, 0.1)
    for place, value, far in ((1, 0.4, 0.4 - 0.1), (1, 0.0, 0.0), (3, 0.0, 0.1)):
        residual[0, place] = value
        assert float(violation(problems, beta, residual)) == far


@given(st.integers(0, 10**6), st.integers(-2, 7), st.sampled_from([None, 0.05]))
@settings(max_examples=25)
def test_a_rough_solution_becomes_an_optimal_one(seed, exponent, epsilon):
    x = rows(seed, 60)
    weight = (torch.arange(60) % 3 != torch.arange(3)[:, None]).double()
    problems = dual_problems(wave(x), 2.0**exponent * ones(3), epsilon, weight)
    kernel = Gram(x, 0.5).matrix
    best = smo_steps(kernel, problems, at_zero(problems), each(problems, 1e-7), 10**6)
    rough = torch.where(best.beta.abs() < 0.02 * problems.cap[:, None], 0.0, best.beta)
    start = State(rough, rough @ kernel, best.bias, best.violation)
    for number in range(3):
        one, at = problems.take(number), torch.tensor([number])
        got = polish(kernel, one, start.take(number), 1e-3)
        if got is None:
            continue
        found = State(*(value[None] for value in vars(got).values()))
        assert_feasible(problems.take(at), found)
        torch.testing.assert_close(got.product, got.beta @ kernel, atol=1e-8, rtol=1e-8)
        residual = one.z - got.beta @ kernel - got.bias
        assert float(violation(one, got.beta, residual)) <= 1e-3
        mine, other = (float(dual_objective(problems.take(at), s)) for s in (found, best.take(at)))
        assert mine <= other + 1e-3 * float(best.beta[number].abs().sum()) + 1e-9


@pytest.mark.parametrize(("gamma", "epsilon"), [(2.0, 0.02), (0.001, None)])
def test_many_free_and_few_free_coefficients_become_exact(gamma, epsilon):
    x = rows(0, 300)
    problems, kernel = dual_problems(wave(x), 512.0, epsilon), Gram(x, gamma).matrix
    rough = smo_steps(kernel, problems, at_zero(problems), each(problems, 1e-2), 10**5)
    found = polish(kernel, problems.take(0), rough.take(0), 1e-7)
    residual = problems.z[0] - found.beta @ kernel - found.bias
    assert float(violation(problems.take(0), found.beta, residual)) <= 2e-7


def test_what_is_hopeless_is_given_up_and_left_as_it_was():
    x, z = rows(0, 300), noise(300)
    problems, kernel = dual_problems(z, 1000.0), Gram(x, 0.01).matrix
    beta = torch.where(z > 0, problems.upper, 0.0)
    start = State(beta, beta @ kernel, 0 * ones(1), ones(1)).take(0)
    before = start.beta.clone()
    assert polish(kernel, problems.take(0), start, 1e-3) is None
    assert torch.equal(start.beta, before)
