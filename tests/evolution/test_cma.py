"""CMA-ES against what it is known to do, and against pycma's own numbers where it is installed."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch.evolution.cma import (
    MOST_FULL,
    Distribution,
    initial_distribution,
    sampled,
    updated,
    usual_count,
)


def minimised(problem: str, n: int, generations: int, seed: int = 0) -> tuple[float, Distribution]:
    distribution = initial_distribution(torch.ones(n), torch.full((n,), 0.5))
    generator, best = seeded(seed), math.inf
    for _ in range(generations):
        x = sampled(distribution, usual_count(n), generator)
        cost = costs(problem, x.double())
        best = min(best, float(cost.min()))
        distribution = updated(distribution, x, -cost)
    return best, distribution


def costs(problem: str, x: Tensor) -> Tensor:
    if problem == "sphere":
        return x.square().sum(1)
    if problem == "ellipsoid":
        return x.square() @ 10 ** torch.linspace(0, 6, x.shape[1], dtype=torch.float64)
    return (100 * (x[:, 1:] - x[:, :-1].square()).square() + (1 - x[:, :-1]).square()).sum(1)


@pytest.mark.parametrize(
    ("problem", "n", "generations"),
    [("sphere", 10, 200), ("ellipsoid", 8, 450), ("rosenbrock", 5, 400), ("sphere", 250, 1200)],
)
def test_known_problems_are_solved(problem: str, n: int, generations: int) -> None:
    start = float(costs(problem, torch.zeros(1, n).double() + 0.3))
    best, _ = minimised(problem, n, generations)
    assert best < 1e-6 * max(1.0, start)


def test_a_covariance_is_that_of_the_inverse_hessian() -> None:
    _, distribution = minimised("ellipsoid", 6, 300)
    variance = distribution.covariance.diagonal()
    ratio = (variance * 10 ** torch.linspace(0, 6, 6, dtype=torch.float64)).log10()
    assert float(ratio.max() - ratio.min()) < 1.5  # of six orders of magnitude


def test_deviations_are_those_asked_for() -> None:
    for n in (3, MOST_FULL + 3):
        wanted = torch.linspace(0.1, 2, n)
        x = sampled(initial_distribution(torch.zeros(n), wanted), 20_000, seeded(1))
        assert ((x.std(0) / wanted - 1).abs() < 0.05).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 12), st.integers(0, 2**31), st.floats(0.1, 5))
def test_only_the_order_of_fitness_counts(n: int, seed: int, scale: float) -> None:
    distribution = initial_distribution(torch.zeros(n), torch.ones(n))
    x = sampled(distribution, usual_count(n), seeded(seed))
    fitness = torch.randn(len(x), generator=seeded(seed + 1)).double()
    one, two = (updated(distribution, x, f) for f in (fitness, (scale * fitness).exp()))
    assert torch.equal(one.mean, two.mean)
    assert torch.equal(one.covariance, two.covariance)
    assert one.step == two.step
    assert torch.allclose(one.covariance, one.covariance.T, rtol=1e-12)
    assert (torch.linalg.eigvalsh(one.covariance) > 0).all()


def test_updates_are_those_of_pycma() -> None:
    cma = pytest.importorskip("cma")
    n, generator = 6, seeded(3)
    options = {
        "CMA_active": False, "verbose": -9, "seed": 1, "CMA_diagonal": 0,
        "AdaptSigma": True, "CSA_squared": False,
    }  # fmt: skip
    other = cma.CMAEvolutionStrategy([1.0] * n, 0.5, options)
    ours = initial_distribution(torch.ones(n), torch.full((n,), 0.5))
    for _ in range(40):
        x = sampled(ours, usual_count(n), generator).double()
        other.ask()
        cost = costs("rosenbrock", x)
        other.tell(list(x.numpy()), cost.tolist())
        ours = updated(ours, x, -cost)
    assert torch.allclose(torch.from_numpy(other.mean), ours.mean, rtol=0.05, atol=0.05)
