"""Measures of dual problems, against their definitions written out row by row."""

from typing import Any

import pytest
import torch
from dual_problems import dual_problems, rows
from hypothesis import given, settings
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch.svm.grid_search import scaled_start
from cgtorch.svm.problems import (
    Problems,
    State,
    Targets,
    at_zero,
    dual_objective,
    duality_gap,
    feasible,
    inside,
    middle_bias,
    relative_gap,
    violation,
)
from cgtorch.svm.rbf import Gram
from cgtorch.svm.solver import _product, solve

seeds = st.integers(0, 2**31)
SIZE = 7


def random_problems(seed: int, count: int = 3) -> Problems:
    """Problems whose boxes are unequal, and some of whose rows are held out."""

    def draw(*shape: int) -> Tensor:
        return torch.rand(count, *shape, generator=generator, dtype=torch.float64)

    generator = seeded(seed)
    inner = draw(SIZE) < 0.8
    z, epsilon, cap = 4 * draw(SIZE) - 2, draw() / 3, draw() + 0.1
    return Problems(z, -draw(SIZE) * inner, draw(SIZE) * inner, epsilon, cap)


def random_state(seed: int, problems: Problems, kernel: Tensor) -> State:
    """Feasible coefficients, of which some are 0 or at a bound, and any biases."""
    wish = 2 * torch.randn(problems.z.shape, generator=seeded(seed), dtype=torch.float64)
    wish = torch.where(torch.rand(wish.shape, generator=seeded(seed)) < 0.3, 0, wish)
    beta = feasible(problems, inside(problems, wish))
    bias = torch.randn(len(beta), generator=seeded(seed + 1), dtype=torch.float64)
    return State(beta, beta @ kernel, bias, torch.full_like(bias, torch.inf))


def kernel_of(seed: int) -> Tensor:
    return Gram(rows(seed % 1000, SIZE), 0.2).matrix


@given(seeds)
@settings(max_examples=20)
def test_the_gap_is_what_the_primal_objective_is_above_the_dual_one(seed: int) -> None:
    problems, kernel = random_problems(seed), kernel_of(seed)
    found = random_state(seed, problems, kernel)
    for p, gap in enumerate(duality_gap(problems, found).tolist()):
        one, s = problems.take(p), found.take(p)
        square = float(s.beta @ kernel @ s.beta) / 2
        primal, width = square, float(one.epsilon)
        for i, residual in enumerate((one.z - s.product - s.bias).tolist()):
            primal += float(one.upper[i]) * max(0, residual - width)
            primal -= float(one.lower[i]) * max(0, -residual - width)
        least = square - float(one.z @ s.beta) + width * float(s.beta.abs().sum())
        assert float(dual_objective(problems, found)[p]) == pytest.approx(least, abs=1e-9)
        # The sum of coefficients is 0 but for rounding, and so is the bias's part in the gap.
        assert gap == pytest.approx(primal + least, abs=1e-9)
        most = float((one.upper - one.lower).sum())
        share = gap / min(max(abs(least), 1e-12 * most), most)
        assert float(relative_gap(problems, found)[p]) == pytest.approx(share, rel=1e-6, abs=1e-9)


@given(seeds)
def test_a_residual_violates_by_what_it_leaves_the_range_that_its_coefficient_allows(
    seed: int,
) -> None:
    problems, kernel = random_problems(seed), kernel_of(seed)
    found = random_state(seed, problems, kernel)
    residual = problems.z - found.product - found.bias[:, None]
    for p, worst in enumerate(violation(problems, found.beta, residual).tolist()):
        one, wrong = problems.take(p), [0.0]
        width = float(one.epsilon)
        for i, beta in enumerate(found.beta[p].tolist()):
            above, below = float(residual[p, i]), -float(residual[p, i])
            if beta < float(one.upper[i]):  # which the loss would raise
                wrong.append(above - (width if beta >= 0 else -width))
            if beta > float(one.lower[i]):
                wrong.append(below - (width if beta <= 0 else -width))
        assert worst == pytest.approx(max(wrong), abs=1e-12)


@given(seeds)
@settings(max_examples=10)
def test_the_nearest_feasible_point_is_the_projection(seed: int) -> None:
    """No step between two coefficients within their boxes comes nearer."""
    problems = random_problems(seed)
    wish = 2 * torch.randn(problems.z.shape, generator=seeded(seed), dtype=torch.float64)
    found = feasible(problems, wish)
    assert torch.equal(inside(problems, found), found)
    assert float(found.sum(1).abs().max()) < 1e-12
    slope = found - wish
    up = slope.masked_fill(found >= problems.upper - 1e-9, torch.inf).amin(1)
    down = slope.masked_fill(found <= problems.lower + 1e-9, -torch.inf).amax(1)
    assert bool((up >= down - 1e-9).all())
    torch.testing.assert_close(feasible(problems, found), found, rtol=0, atol=1e-12)


@given(seeds)
def test_a_start_for_a_larger_cost_is_the_best_multiple_up_to_its_ratio(seed: int) -> None:
    kernel, z = kernel_of(seed), 2 * torch.randn(SIZE, generator=seeded(seed)).double()
    small, ratio = torch.tensor([0.05, 0.5]).double(), torch.tensor([8.0, 1.5]).double()
    before, after = (dual_problems(z, cap, 0.1) for cap in (small, small * ratio))
    found = solve(Gram(rows(seed % 1000, SIZE), 0.2), before)
    start = scaled_start(before, found, after)
    assert torch.equal(inside(after, start.beta), start.beta)
    torch.testing.assert_close(start.product, start.beta @ kernel)
    objective = dual_objective(after, start)
    for share in torch.linspace(0, 1, 11).tolist():
        factor = 1 + share * (ratio - 1)
        other = State(found.beta * factor[:, None], found.product * factor[:, None], *[ratio] * 2)
        assert bool((objective <= dual_objective(after, other) + 1e-9).all())


def test_a_bias_that_nothing_fixes_is_in_the_middle_of_those_that_are_best() -> None:
    """All coefficients are at a bound, so each row allows the bias a range."""
    z = torch.tensor([2.0, 3.0, -1.0, -4.0]).double()
    problems = dual_problems(z, 0.5, 0.25)
    beta = torch.tensor([[0.5, 0.5, -0.5, -0.5]]).double()
    found = State(beta, torch.zeros_like(beta), torch.tensor([9.0]).double(), torch.zeros(1))
    # 2 - b is at least 0.25, and -1 - b at most -0.25.
    assert middle_bias(problems, found).tolist() == [(1.75 + -0.75) / 2]
    free = State(beta / 2, found.product, found.bias, found.violation)
    assert middle_bias(problems, free).tolist() == [9.0]  # which free ones have determined


def test_problems_are_taken_put_and_start_at_zero() -> None:
    problems, other = random_problems(0), random_problems(1)
    assert torch.equal(problems.reach, torch.maximum(problems.upper, -problems.lower).amax(1))
    some = problems.take(torch.tensor([2, 0]))
    assert torch.equal(some.z, problems.z[[2, 0]])
    some.put(torch.tensor([1]), other.take(torch.tensor([1])))
    for name, value in vars(some).items():
        assert torch.equal(value[0], getattr(problems, name)[2])
        assert torch.equal(value[1], getattr(other, name)[1])
    start = at_zero(problems)
    assert not any(bool(x.any()) for x in (start.beta, start.product, start.bias))
    assert start.violation.tolist() == [torch.inf] * 3
    assert start.beta.data_ptr() != start.product.data_ptr()


def test_values_come_back_in_the_unit_of_their_targets() -> None:
    two = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    targets = Targets(two, two, torch.tensor([10.0, 20.0]), torch.tensor([2.0, 4.0]), None, False)
    assert targets.restored(two).tolist() == [[12, 14], [32, 36]]
    assert targets.restored(two.expand(3, 2, 2)).shape == (3, 2, 2)


@pytest.mark.parametrize("used", [0, 1, 2, 5, SIZE])
def test_a_product_is_the_same_however_many_coefficients_are_zero(used: int) -> None:
    kernel, d = kernel_of(used), torch.zeros(SIZE, dtype=torch.float64)
    d[torch.randperm(SIZE, generator=seeded(used))[:used]] = 1.5
    found: Any = _product(kernel, d)
    torch.testing.assert_close(found, kernel @ d, rtol=1e-12, atol=1e-14)
