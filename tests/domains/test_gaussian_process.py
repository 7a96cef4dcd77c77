"""Γ as a Gaussian process against the plain formulas, and what it learns of motions."""

import math

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.domains.gaussian_process import (
    LEAST_NOISE,
    GaussianProcess,
    Kernel,
    first_guess,
    fitted_parameters,
    inducing_rows,
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
