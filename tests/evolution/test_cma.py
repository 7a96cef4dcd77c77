"""CMA-ES against what it is known to do, and against pycma's own numbers."""

import math
from dataclasses import replace
from statistics import NormalDist

import cma
import numpy as np
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
    # Rosenbrock's function has a second minimum, in which one of forty searches ends.
    found = sorted(minimised(problem, n, generations, seed)[0] for seed in range(3))
    assert found[1] < 1e-6 * max(1.0, start)


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


def plainly(old: Distribution, x: Tensor, fitness: Tensor) -> Distribution:
    """An update in numpy, in the notation of the tutorial, figure 6 and table 1."""
    lam, n = x.shape
    mu = lam // 2
    w = np.array([math.log((lam + 1) / 2) - math.log(i) for i in range(1, mu + 1)])
    w = w / w.sum()
    mu_eff = w.sum() ** 2 / (w**2).sum()
    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
    d_sigma = 1 + 2 * max(0, math.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma
    c_c = (4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n)
    separable = old.covariance.dim() == 1
    faster = (n + 2) / 3 if separable else 1
    c_1 = 2 / ((n + 1.3) ** 2 + mu_eff) * faster
    c_1 = min(1, c_1)
    c_mu = min(1 - c_1, 2 * (mu_eff - 2 + 1 / mu_eff) / ((n + 2) ** 2 + mu_eff) * faster)
    chi = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    C = old.covariance.numpy()
    C = np.diag(C) if separable else C
    order = np.argsort(-fitness.numpy(), kind="stable")
    y = (x.double().numpy()[order] - old.mean.numpy()) / old.step
    if separable:  # all samples move the mean, in proportion to expected ranks
        m = np.array([NormalDist().inv_cdf((i - 0.375) / (lam + 0.25)) for i in range(lam, 0, -1)])
        m = m / np.abs(m).sum()
        y_w = sum(m[i] * y[i] for i in range(lam))
        y_n = y_w / math.sqrt((m**2).sum() * lam / (lam - 1))
    else:
        y_w = sum(w[i] * y[i] for i in range(mu))
        y_n = math.sqrt(mu_eff) * y_w
    values, B = np.linalg.eigh(C)
    root = B @ np.diag(values**-0.5) @ B.T
    p_sigma = (1 - c_sigma) * old.step_path.numpy()
    p_sigma = p_sigma + math.sqrt(c_sigma * (2 - c_sigma)) * root @ y_n
    length = float(np.linalg.norm(p_sigma))
    step = old.step * math.exp(min(1, c_sigma / d_sigma * (length / chi - 1)))
    bound = (1.4 + 2 / (n + 1)) * chi
    h = length / math.sqrt(1 - (1 - c_sigma) ** (2 * (old.updates + 1))) < bound
    h = h or separable
    p_c = (1 - c_c) * old.path.numpy() + h * math.sqrt(c_c * (2 - c_c)) * y_n
    delta = (1 - h) * c_c * (2 - c_c)
    C = (1 + c_1 * delta - c_1 - c_mu) * C + c_1 * np.outer(p_c, p_c)
    C = C + c_mu * sum(w[i] * np.outer(y[i], y[i]) for i in range(mu))
    if not separable:
        v = np.array([math.log((lam + 1) / 2) - math.log(i) for i in range(1, lam + 1)])
        v = np.minimum(v[mu:], 0)
        mu_neg = v.sum() ** 2 / (v**2).sum()
        alpha = min(1 + c_1 / c_mu, 1 + 2 * mu_neg / (mu_eff + 2), (1 - c_1 - c_mu) / (n * c_mu))
        v = alpha * v / np.abs(v).sum()
        C = C - c_mu * v.sum() * old.covariance.numpy()
        for weight, step_of in zip(v, y[mu:], strict=True):
            C = C + c_mu * weight * n / np.linalg.norm(root @ step_of) ** 2 * np.outer(
                step_of, step_of
            )
    mean, path, step_path, C = map(torch.tensor, (
        old.mean.numpy() + old.step * y_w, p_c, p_sigma, np.diag(C) if separable else C
    ))  # fmt: skip
    return Distribution(mean, step, C, path, step_path, old.updates + 1)


@given(
    st.integers(1, 7),
    st.integers(4, 40),
    st.integers(0, 2**31),
    st.booleans(),
    st.sampled_from([0.1, 1.0, 9.0]),
)
def test_an_update_is_that_of_the_sources(
    n: int, count: int, seed: int, full: bool, moved: float
) -> None:
    """After paths of any length, a long one of which stalls the rank-one update.

    Each of the three bounds of the rate of worse samples decides for some n and count.
    """
    generator = seeded(seed)
    start = initial_distribution(torch.zeros(n), torch.rand(n, generator=generator) + 0.1, n * full)
    path, step_path = (moved * torch.randn(n, generator=generator).double() for _ in range(2))
    place = Distribution(start.mean, 0.7, start.covariance, path, step_path, seed % 9)
    for _ in range(2):
        x = sampled(place, count, generator)
        fitness = torch.randn(count, generator=generator)
        after, wanted = updated(place, x, fitness), plainly(place, x, fitness)
        for name in ("mean", "covariance", "path", "step_path"):
            assert torch.allclose(getattr(after, name), getattr(wanted, name), rtol=1e-6), name
        assert after.step == pytest.approx(wanted.step)
        assert after.updates == wanted.updates
        place = after


def test_samples_at_the_mean_change_nothing_along_their_steps() -> None:
    """As they are float32, all samples of a converged distribution may be its mean."""
    start = initial_distribution(torch.ones(3), torch.ones(3))
    after = updated(start, start.mean.float().expand(10, 3), torch.arange(10))
    assert torch.equal(after.mean, start.mean)
    assert (torch.linalg.eigvalsh(after.covariance) > 0).all()


def test_samples_of_many_parameters_are_pairs_on_both_sides_of_the_mean() -> None:
    mean, deviation = torch.tensor([5.0, -3.0]), torch.tensor([1.0, 2.0])
    apart = initial_distribution(mean, deviation, most_full=0)
    for count in (6, 7):
        x = sampled(apart, count, seeded(1)) - mean
        half = (count + 1) // 2
        assert torch.allclose(x[half:], -x[: count - half], atol=1e-6)
        assert len(x) == count
    together = sampled(initial_distribution(mean, deviation), 6, seeded(1)) - mean
    assert not torch.allclose(together[3:], -together[:3], atol=0.1)


@pytest.mark.parametrize("apart", [True, False])
def test_the_path_of_steps_keeps_its_size_where_fitness_is_chance(apart: bool) -> None:
    n, generator = 80, seeded(2)
    place = initial_distribution(torch.zeros(n), torch.ones(n), 0 if apart else n)
    start = torch.randn(n, generator=generator).double()
    place = replace(place, step_path=start)
    lengths = []
    for _ in range(200):
        x = sampled(place, 6, generator)
        place = updated(place, x, torch.rand(6, generator=generator))
        lengths.append(float(place.step_path.square().mean()))
    assert np.mean(lengths) == pytest.approx(1, abs=0.15)


def test_updates_are_those_of_pycma() -> None:
    n, generator = 6, seeded(3)
    options = {
        "CMA_active": True, "verbose": -9, "seed": 1, "CMA_diagonal": 0,
        "AdaptSigma": True, "CSA_squared": False,
    }  # fmt: skip
    other = cma.CMAEvolutionStrategy([1.0] * n, 0.5, options)
    ours = initial_distribution(torch.ones(n), torch.full((n,), 0.5))
    for update in range(40):
        x = sampled(ours, usual_count(n), generator).double()
        other.ask()
        cost = costs("rosenbrock", x)
        other.tell(list(x.numpy()), cost.tolist())
        ours = updated(ours, x, -cost)
        assert torch.allclose(torch.from_numpy(other.mean), ours.mean)
        # Ours begins with the variances, pycma with the step size. Rates differ a little.
        assert other.sigma / (0.5 * ours.step) == pytest.approx(1, rel=0.08)
        one, two = (c / c.trace() for c in (torch.from_numpy(other.C), ours.covariance))
        # Without the worse samples, it would be off by 8 % at once.
        assert update >= 5 or float((one - two).norm() / two.norm()) < 0.04
