"""Rounds of compiled steps beside plain ones: which rows are solved, and what ends a round."""

import pytest
import torch
from dual_problems import dual_problems, ones, rows
from torch import Tensor

from cgtorch.native import VECTOR, available
from cgtorch.svm import smo
from cgtorch.svm.problems import Problems, State, at_zero, relative_gap
from cgtorch.svm.rbf import Gram
from cgtorch.svm.smo import compiled_smo_steps, smo_steps

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

LEAST_SET = 64
BLOCK = VECTOR // 8


def compiled(gram: Gram, problems: Problems, start: State, tolerance: float, worth: float) -> State:
    aim = torch.full_like(problems.cap, tolerance)
    found = compiled_smo_steps(gram.double, problems, start, aim, worth, 1)
    assert found is not None
    return found


def plain(matrix: Tensor, problems: Problems, start: State, tolerance: Tensor, steps: int) -> State:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(smo, "GAP", torch.inf)
        return smo_steps(matrix, problems, start, tolerance, steps)


def assert_same(found: State, wanted: State) -> None:
    for name, value in vars(wanted).items():
        given = getattr(found, name)
        given = given.clamp_min(0) if name == "violation" else given
        torch.testing.assert_close(given, value, atol=1e-9, rtol=1e-9, msg=name)


def some_problems(n: int, epsilon: float | None) -> tuple[Gram, Problems]:
    """Three costs; a few rows are held out, and others have boxes of their own."""
    x = rows(n, n)
    weight = torch.where(torch.arange(n) % 7 == 3, 0.0, 0.5 + torch.arange(n) % 4).double()
    z = (2 * x[:, 0]).sin() + 0.3 * x[:, 1]
    z = z - z.median()
    problems = dual_problems(z, 2.0 ** torch.arange(0, 6, 2), epsilon, weight.repeat(3, 1))
    return Gram(x, 0.4), problems


@pytest.mark.parametrize("epsilon", [None, 0.0, 0.05])
@pytest.mark.parametrize("n", [8, 9, 21])
def test_the_first_round_takes_a_plain_step_for_each_row(n: int, epsilon: float | None) -> None:
    gram, problems = some_problems(n, epsilon)
    start = at_zero(problems)
    far = plain(gram.matrix, problems, start, 0 * ones(3), 0).violation
    found = compiled(gram, problems, start, 1e-6, 0.0)
    # A round ends earlier where it has left a tenth of the violation.
    assert_same(found, plain(gram.matrix, problems, start, 0.1 * far, n))
    assert bool((found.violation < far).all())


@pytest.mark.parametrize("epsilon", [None, 0.05])
def test_a_round_costs_its_steps_and_what_they_change(epsilon: float | None) -> None:
    gram, problems = some_problems(21, epsilon)
    problems = problems.take(torch.tensor([2]))
    start = at_zero(problems)
    one = compiled(gram, problems, start, 1e-6, 0.0)
    steps = next(
        most for most in range(22)
        if plain(gram.matrix, problems, start, 0 * ones(1), most).beta.allclose(one.beta)
    )  # fmt: skip
    left = int((problems.upper > problems.lower).sum())  # of which all are gathered next
    cost = 21.0 * (steps + int((one.beta != 0).sum())) + 4 * left**2 - left**2
    assert torch.equal(compiled(gram, problems, start, 1e-6, cost).beta, one.beta)
    assert not torch.equal(compiled(gram, problems, start, 1e-6, cost + left).beta, one.beta)


@pytest.mark.parametrize("epsilon", [None, 0.05])
def test_a_round_leaves_half_of_a_tolerance_that_is_nearly_met(epsilon: float | None) -> None:
    gram, problems = some_problems(12, epsilon)
    start = at_zero(problems)
    far = plain(gram.matrix, problems, start, 0 * ones(3), 0).violation
    found = compiled(gram, problems, start, float(far[0]) * 0.9, 0.0)
    assert_same(found, plain(gram.matrix, problems, start, 0.45 * far, 12))


def nearest(problem: Problems, found: State) -> tuple[Tensor, int]:
    """The rows of the next set, from its definition, and how many nearly violate the conditions."""
    beta, slope, width = found.beta[0], problem.z - found.product[0], problem.epsilon
    up = slope - torch.where(beta >= 0, width, -width)
    down = slope - torch.where(beta > 0, width, -width)
    up = up.masked_fill(beta >= problem.upper, -torch.inf)
    down = down.masked_fill(beta <= problem.lower, torch.inf)
    middle = (up.max() + down.min()) / 2
    score = torch.maximum(up - middle, middle - down)
    near = int((score > -0.1 * (up.max() - down.min())).sum())
    want = min(max(near + near // 4 + BLOCK, LEAST_SET), int(score.isfinite().sum()))
    return score.argsort(descending=True, stable=True)[:want].sort().values, near


def a_round(gram: Gram, problems: Problems, start: State, most: int) -> State:
    """Plain steps on the nearest rows of a single problem, to a tenth of the violation."""
    matrix, index = gram.matrix, nearest(problems.take(0), start)[0]
    part = Problems(*(v[:, index] if v.dim() == 2 else v for v in vars(problems).values()))
    inside = State(start.beta[:, index], start.product[:, index], start.bias, start.violation)
    aim = 0.1 * plain(matrix, problems, start, 0 * ones(1), 0).violation
    beta = start.beta.clone()
    beta[:, index] = plain(matrix[index][:, index], part, inside, aim, most).beta
    found = State(beta, beta @ matrix, start.bias, start.violation)
    return plain(matrix, problems, found, 0 * ones(1), 0)


def nearly_solved(
    n: int, epsilon: float | None, cost: float, off: int, held_out: int = 0
) -> tuple[Gram, Problems, State]:
    """A single problem, and its solution but for some rows that were taken off their bounds."""
    x = rows(3, n, duplicates=True)
    z = (2 * x[:, 0]).sin() + 0.3 * x[:, 1]
    weight = (torch.arange(n) >= held_out).double()[None]
    problems, gram = dual_problems(z - z.median(), cost, epsilon, weight), Gram(x, 0.4)
    start = plain(gram.matrix, problems, at_zero(problems), 1e-2 * ones(1), 10**4)
    beta = start.beta.clone()
    for end in (problems.upper, problems.lower):
        beta[0, ((beta == end) & (end != 0))[0].nonzero()[:off, 0]] = 0
    start = State(beta, beta @ gram.matrix, start.bias, start.violation)
    assert 4 * nearest(problems.take(0), start)[1] <= n
    return gram, problems, start


CROWDS = [(80, None, 0.1, 6), (200, 0.01, 0.005, 3), (400, None, 0.02, 33)]


@pytest.mark.parametrize(("n", "epsilon", "cost", "off"), CROWDS)
def test_a_later_round_solves_the_nearest_rows_alone(
    n: int, epsilon: float | None, cost: float, off: int
) -> None:
    """Where few violate the conditions; of equal rows the first, and none that are held out."""
    for held_out in (0, 30):
        gram, problems, start = nearly_solved(n, epsilon, cost, off, held_out)
        count = len(nearest(problems.take(0), start)[0])
        gathered = 4.0 * count**2
        assert_same(
            compiled(gram, problems, start, 1e-9, gathered), a_round(gram, problems, start, count)
        )
        fewer = compiled(gram, problems, start, 1e-9, gathered - count * (count - 3))
        assert_same(fewer, a_round(gram, problems, start, 3))


def test_a_round_that_would_cost_too_much_is_not_begun() -> None:
    gram, problems, start = nearly_solved(*CROWDS[0])
    found = compiled(gram, problems, start, 1e-9, 0.0)
    assert torch.equal(found.beta, start.beta)
    assert float(found.violation) > 1e-3


@pytest.mark.parametrize("epsilon", [None, 0.05])
def test_a_problem_ends_only_with_a_small_duality_gap(
    epsilon: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    gram, problems = some_problems(40, epsilon)
    start = plain(gram.matrix, problems, at_zero(problems), 0.3 * ones(3), 10**4)
    problems, start = problems.take(torch.tensor([1])), start.take(torch.tensor([1]))
    gap, wrong = float(relative_gap(problems, start)), float(start.violation)
    assert 1e-3 < gap < 10
    for allowed, ends in ((gap * (1 + 1e-9), True), (gap * (1 - 1e-9), False)):
        monkeypatch.setattr(smo, "GAP", allowed)
        found = compiled(gram, problems, start, wrong * 1.01, 1e9)
        assert torch.equal(found.beta, start.beta) == ends
        assert float(found.bias) == pytest.approx(float(start.bias)) or not ends
        assert float(relative_gap(problems, found)) <= allowed
    found = compiled(gram, problems, start, wrong, 1e9)  # the violation has to be below
    assert not torch.equal(found.beta, start.beta)


def test_no_gap_is_worth_a_violation_far_below_the_tolerance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gram, problems = some_problems(40, 0.05)
    monkeypatch.setattr(smo, "GAP", -1.0)
    found = compiled(gram, problems, at_zero(problems), 0.1, 1e9)
    assert 1e-6 < float(found.violation.max()) < 0.1 * 0.25**5


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_a_single_class_nothing_moves_and_the_bias_is_where_it_may_be(sign: float) -> None:
    x = rows(1, 9)
    problems, gram = dual_problems(sign * ones(9), 2.0), Gram(x, 0.4)
    wanted = plain(gram.matrix, problems, at_zero(problems), 1e-3 * ones(1), 10)
    found = compiled(gram, problems, at_zero(problems), 1e-3, 1e9)
    assert_same(found, wanted)
    assert float(found.bias) == sign
    shut = Problems(problems.z, 0 * problems.z, 0 * problems.z, problems.epsilon, problems.cap)
    found = compiled(gram, shut, at_zero(shut), 1e-3, 1e9)
    assert (float(found.bias), float(found.violation)) == (0, 0)
