"""Γ as a Gaussian process against the plain formulas, and what it learns of motions."""

import math

import pytest
import torch
from sklearn.gaussian_process.kernels import RBF, DotProduct
from support import seeded
from torch import Tensor

from cgtorch.domains import gaussian_process
from cgtorch.domains.gaussian_process import (
    LEAST_NOISE,
    Folded,
    GaussianProcess,
    Kernel,
    first_guess,
    fitted_parameters,
    inducing_rows,
    projected,
)
from cgtorch.ground.errors import DataError


def swung(percept: Tensor, control: Tensor) -> Tensor:
    """A pendulum: angle and velocity after a push."""
    angle, speed = percept.unbind(1)
    speed = speed + 0.3 * angle.sin() + 0.1 * control[:, 0]
    return torch.stack([angle + 0.1 * speed, speed], 1)


def motions(count: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    g = seeded(seed)
    percept = 4 * torch.rand(count, 2, generator=g).double() - 2
    control = 2 * torch.rand(count, 1, generator=g).double() - 1
    return percept, control, swung(percept, control)


@pytest.fixture(scope="module")
def known() -> GaussianProcess:
    return GaussianProcess(*motions(150, 0))


def plain(model: GaussianProcess, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
    """Means and deviations of the exact process on all of its 150 rows (eqs. 2.25 and 2.26)."""
    p, u, q = motions(150, 0)
    x, asked = (
        (torch.cat(rows, 1) - model.mean) / model.scale for rows in ((p, u), (percept, control))
    )
    y, k = (q - p - model.shift) / model.spread, model.kernel
    gram, across = k(x, x) + k.noise * torch.eye(len(x)), k(asked, x)
    mean = percept + model.shift + model.spread * (across @ torch.linalg.solve(gram, y))
    variance = k.alone(asked) - (across * torch.linalg.solve(gram, across.T).T).sum(1)
    return mean, variance.clamp_min(0).sqrt()


def test_it_says_what_the_exact_process_says(known: GaussianProcess) -> None:
    percept, control, _ = motions(40, 1)
    after, unsure = known.predict(percept, control)
    mean, deviation = plain(known, percept, control)
    assert len(known.pivots) < 150
    torch.testing.assert_close(after, mean, atol=3e-3, rtol=0.0)
    torch.testing.assert_close(unsure, deviation, atol=5e-3, rtol=0.5)


def test_it_learns_a_motion_from_few_transitions(known: GaussianProcess) -> None:
    percept, control, truth = motions(100, 2)
    after, unsure = known.predict(percept, control)
    assert float(((after - truth) / known.spread).abs().mean()) < 0.01
    assert float(unsure.median()) < 0.02


def test_it_is_unsure_of_what_is_far_off(known: GaussianProcess) -> None:
    percept, control, _ = motions(20, 3)
    near, far = (known.predict(percept + off, control)[1].mean() for off in (0, 20))
    assert far > 10 * near


def test_lines_go_on_beyond_the_data() -> None:
    percept, control, _ = motions(60, 4)
    model = GaussianProcess(percept, control, percept + 0.5 * control + 0.1)
    after, _ = model.predict(torch.full((1, 2), 9.0).double(), torch.full((1, 1), 5.0).double())
    torch.testing.assert_close(after, torch.full((1, 2), 11.6).double(), atol=0.1, rtol=0.0)


def test_the_choice_makes_the_data_more_likely() -> None:
    p, u, q = motions(60, 5)
    x, y = torch.cat([p, u], 1), (q - p) / (q - p).std(0)
    guess = first_guess(3)

    def log_likelihood(free: Tensor) -> float:
        kernel = Kernel.of(free)
        gram = kernel(x, x) + kernel.noise * torch.eye(len(x))
        normal = torch.distributions.MultivariateNormal(torch.zeros(len(x)).double(), gram)
        return float(normal.log_prob(y.T).sum())

    found = fitted_parameters(guess, x, y, 30)
    assert log_likelihood(found) > log_likelihood(guess) + 10
    first = fitted_parameters(guess, x, y, 1)
    assert log_likelihood(guess) < log_likelihood(first) < log_likelihood(found) - 10
    assert float(Kernel.of(found).noise) >= LEAST_NOISE**2


def test_rows_that_are_told_by_others_are_no_pivots() -> None:
    x = torch.rand(10, 2, generator=seeded(6)).double()
    kernel = Kernel.of(first_guess(2))
    rows = inducing_rows(kernel, torch.cat([x, x]))
    assert len(rows) <= 10
    assert len({int(row) % 10 for row in rows}) == len(rows)


def test_the_same_data_give_the_same_process() -> None:
    percept, control, _ = motions(5, 7)
    one, other = (GaussianProcess(*motions(40, 0)).predict(percept, control) for _ in range(2))
    assert torch.equal(one[0], other[0])
    assert torch.equal(one[1], other[1])


def test_data_that_cannot_be_learnt_from_are_named() -> None:
    p, u, q = motions(10, 0)
    with pytest.raises(DataError, match="percept, control and next percept are"):
        GaussianProcess(p, u[:5], q)
    with pytest.raises(DataError, match="transitions"):
        GaussianProcess(p, u, torch.full_like(q, math.nan))


def some_kernel() -> Kernel:
    return Kernel.of(torch.tensor([0.2, -0.3, 0.5, -0.4, -3.0]).double())


def test_covariances_are_those_of_scikit_learn() -> None:
    kernel = some_kernel()
    x, other = (torch.randn(n, 2, generator=seeded(n)).double() for n in (5, 7))
    smooth, a, b = RBF([math.exp(0.2), math.exp(-0.3)]), x.numpy(), other.numpy()
    wanted = math.exp(0.5) * smooth(a, b) + math.exp(-0.4) * DotProduct(1.0)(a, b)
    torch.testing.assert_close(kernel(x, other), torch.from_numpy(wanted))
    torch.testing.assert_close(kernel.alone(x), kernel(x, x).diagonal())
    assert float(kernel.noise) == pytest.approx(math.exp(-3.0) + LEAST_NOISE**2)


def test_a_fit_is_where_data_and_prior_are_likeliest() -> None:
    p, u, q = motions(40, 8)
    x, y = torch.cat([p, u], 1), (q - p) / (q - p).std(0)
    guess = first_guess(3)

    def likely(free: Tensor) -> float:
        kernel = Kernel.of(free)
        gram = kernel(x, x) + kernel.noise * torch.eye(len(x))
        normal = torch.distributions.MultivariateNormal(torch.zeros(len(x)).double(), gram)
        return float(normal.log_prob(y.T).sum() - ((free - guess) / 3).square().sum())

    found = fitted_parameters(guess, x, y, 300)
    for off in torch.eye(len(found)).double():
        assert likely(found) > max(likely(found + 0.05 * off), likely(found - 0.05 * off))


def test_parameters_that_no_data_could_have_are_left_as_they_are() -> None:
    p, u, q = motions(10, 0)
    far = torch.full((6,), 800.0).double()
    assert torch.equal(fitted_parameters(far, torch.cat([p, u], 1), q - p, 5), far)


def test_each_next_pivot_is_what_those_before_tell_least_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel, x = some_kernel(), torch.randn(60, 2, generator=seeded(9)).double()

    def left(rows: list[int]) -> Tensor:
        """Variances given the values at some rows."""
        prior, across = kernel.alone(x), kernel(x, x[rows])
        known = torch.linalg.solve(kernel(x[rows], x[rows]), across.T).T
        return prior - (known * across).sum(1) if rows else prior

    rows = inducing_rows(kernel, x).tolist()
    assert 2 < len(rows) < 60
    for count, row in enumerate(rows):
        assert row == int(left(rows[:count]).argmax())
    assert left(rows[:-1]).max() > kernel.noise > left(rows).max()
    monkeypatch.setattr(gaussian_process, "MOST_PIVOTS", 3)
    assert inducing_rows(kernel, x).tolist() == rows[:3]


def test_weights_are_those_of_the_projected_process() -> None:
    """Rasmussen and Williams, eqs. 8.26 and 8.27."""
    kernel, x = some_kernel(), torch.randn(30, 2, generator=seeded(10)).double()
    pivots, y = x[:6], torch.randn(30, 3, generator=seeded(11)).double()
    gram = kernel(pivots, pivots) + 1e-3 * kernel.noise * torch.eye(6)
    across = kernel(pivots, x)
    inner = kernel.noise * gram + across @ across.T
    weights, known = projected(kernel, pivots, x, y)
    torch.testing.assert_close(weights, torch.linalg.solve(inner, across @ y))
    less = torch.linalg.inv(gram) - kernel.noise * torch.linalg.inv(inner)
    torch.testing.assert_close(known @ known.T, less)


def test_folded_sums_are_those_of_covariances() -> None:
    kernel, pivots = some_kernel(), torch.randn(6, 2, generator=seeded(12)).double()
    columns = torch.randn(6, 4, generator=seeded(13)).double()
    mean, scale = torch.tensor([3.0, -1.0]).double(), torch.tensor([0.5, 4.0]).double()
    x = 3 * torch.randn(9, 2, generator=seeded(14)).double()
    folded = Folded.of(kernel, pivots, mean, scale, columns)
    found = folded(torch.cat([x, torch.ones(9, 1)], 1))
    torch.testing.assert_close(found, kernel((x - mean) / scale, pivots) @ columns)


def test_predictions_are_those_of_the_projected_process(known: GaussianProcess) -> None:
    p, u, q = motions(150, 0)
    percept, control, _ = motions(40, 1)
    x, asked = (
        (torch.cat(rows, 1) - known.mean) / known.scale for rows in ((p, u), (percept, control))
    )
    weights, told = projected(known.kernel, known.pivots, x, (q - p - known.shift) / known.spread)
    across = known.kernel(asked, known.pivots)
    variance = known.kernel.alone(asked) - (across @ told).square().sum(1)
    after, unsure = known.predict(percept.float(), control.float())
    mean = percept + known.shift + known.spread * (across @ weights)
    torch.testing.assert_close(after, mean, atol=1e-5, rtol=0.0)
    torch.testing.assert_close(unsure, variance.clamp_min(0).sqrt(), atol=1e-3, rtol=1e-3)
    assert after.dtype == unsure.dtype == torch.float64
    assert known.control_size == 1


def test_a_process_is_fitted_to_some_rows_and_predicts_from_all(
    monkeypatch: pytest.MonkeyPatch, known: GaussianProcess
) -> None:
    monkeypatch.setattr(gaussian_process, "MOST_ROWS", 30)
    data = motions(150, 0)
    few = GaussianProcess(*data)
    percept, control, truth = motions(60, 2)
    assert not torch.equal(few.free, known.free)
    assert float((few.predict(percept, control)[0] - truth).abs().mean()) < 0.01
    assert torch.equal(few.mean, known.mean)


def test_a_later_fit_goes_on_from_an_earlier_one(known: GaussianProcess) -> None:
    again = GaussianProcess(*motions(150, 0), known.free)
    torch.testing.assert_close(again.free, known.free, atol=0.3, rtol=0.0)
    assert len(again.free) == 3 + 3
