"""CMA-ES (Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772), with its constants.

The worse half of samples lowers the variance along their steps (active CMA-ES: Jastrebski and
Arnold, "Improving evolution strategies through active covariance matrix adaptation", CEC 2006).

Of many parameters, only the variances are learned, with the rates of sep-CMA-ES (Ros and Hansen, "A
simple modification in CMA-ES achieving linear time and space complexity", PPSN 2008). There an
update has far fewer samples than parameters, so that the worse half tells as much as the better
one. Samples are pairs on both sides of the mean (Brockhoff et al., "Mirrored sampling and
sequential selection for evolution strategies", PPSN 2010), and all move it, the worse ones away
from them (Arnold, "Weighted multirecombination evolution strategies", Theoretical Computer Science
361, 2006).
"""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

MOST_FULL = 200  # parameters for which covariances are learned by default
LEAST_VARIANCE = 1e-20  # of any direction, in units of the squared step size


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Distribution:
    """A normal distribution of n parameters; all tensors are float64.

    Attributes:
        mean: (n,).
        step: The step size σ.
        covariance: C (n, n), or only its diagonal (n,) where only variances are learned.
        path: (n,) the evolution path of C.
        step_path: (n,) the evolution path of the step size.
        updates: Number of updates so far.
    """

    mean: Tensor
    step: float
    covariance: Tensor
    path: Tensor
    step_path: Tensor
    updates: int = 0


def initial_distribution(
    mean: Tensor, deviation: Tensor, most_full: int = MOST_FULL
) -> Distribution:
    """The uncorrelated distribution with a mean (n,) and standard deviations (n,).

    Covariances are learned of up to `most_full` parameters.
    """
    n, mean, variance = len(mean), mean.double(), deviation.double().square()
    zeros = torch.zeros_like(mean)
    covariance = variance.diag() if n <= most_full else variance
    return Distribution(mean, 1.0, covariance, zeros, zeros)


def usual_count(parameters: int) -> int:
    """The default number λ of samples per generation."""
    return 4 + int(3 * math.log(max(1, parameters)))


def sampled(distribution: Distribution, count: int, generator: Generator) -> Tensor:
    """(count, n) float32 samples; where only variances are learned, the second half mirrors."""
    n, (basis, scale) = len(distribution.mean), axes(distribution.covariance)
    if basis is None:
        half = torch.randn((count + 1) // 2, n, generator=generator).double()
        moved = torch.cat([half, -half])[:count] * scale
    else:
        moved = (torch.randn(count, n, generator=generator).double() * scale) @ basis.T
    return (distribution.mean + distribution.step * moved).float()


def axes(covariance: Tensor) -> tuple[Tensor | None, Tensor]:
    """Principal axes (n, n), or None for a diagonal covariance, and standard deviations (n,)."""
    if covariance.dim() == 1:
        return None, covariance.clamp_min(LEAST_VARIANCE).sqrt()
    variance, basis = torch.linalg.eigh(covariance)
    return basis, variance.clamp_min(LEAST_VARIANCE).sqrt()


def updated(distribution: Distribution, samples: Tensor, fitness: Tensor) -> Distribution:
    """The distribution after an update by samples (λ, n) and their fitness (λ,); more is better."""
    order = fitness.argsort(descending=True, stable=True)
    steps = (samples.double()[order] - distribution.mean) / distribution.step
    if distribution.covariance.dim() == 1:
        return _apart(distribution, steps)
    return _together(distribution, steps)


def _together(old: Distribution, steps: Tensor) -> Distribution:
    """The update of the tutorial by steps (λ, n), the best one first."""
    weights, n = recombination_weights(len(steps)), len(old.mean)
    better, mass = len(weights), 1 / float(weights.square().sum())  # μ, μ_eff
    c_path, c_one, c_many = _covariance_rates(n, mass)
    shift = weights @ steps[:better]
    basis, scale = axes(old.covariance)
    assert basis is not None  # noqa: S101  as covariances are learned
    white = (steps @ basis) / scale
    moved = basis @ (weights @ white[:better])
    step_path, step, length = _step_after(old, moved * math.sqrt(mass), mass)
    c_step = _step_rate(n, mass)
    grown = math.sqrt(1 - (1 - c_step) ** (2 * (old.updates + 1)))
    calm = float(length / grown < 1.4 + 2 / (n + 1))
    path = (1 - c_path) * old.path + calm * math.sqrt(c_path * (2 - c_path) * mass) * shift
    doubts = _doubts(len(steps))
    c_worse = _rate_of_worse(n, mass, float(1 / doubts.square().sum()))
    # Each worse step counts as if it had the usual length, so that variances stay above 0.
    lengths = white[better:].square().sum(1).clamp_min(LEAST_VARIANCE)
    every = torch.cat([c_many * weights, -c_worse * doubts * n / lengths])
    kept = 1 - c_one - c_many + c_worse + (1 - calm) * c_one * c_path * (2 - c_path)
    covariance = kept * old.covariance + c_one * path.outer(path) + (steps.T * every) @ steps
    mean = old.mean + shift * old.step
    return Distribution(mean, step, covariance, path, step_path, old.updates + 1)


def _apart(old: Distribution, steps: Tensor) -> Distribution:
    """The update where only variances are learned, by steps (λ, n), the best one first."""
    weights, pull, n = recombination_weights(len(steps)), _pull(len(steps)), len(old.mean)
    mass = 1 / float(weights.square().sum())
    c_path, c_one, c_many = _covariance_rates(n, mass)
    c_one = min(1.0, c_one * (n + 2) / 3)
    c_many = min(1 - c_one, c_many * (n + 2) / 3)
    shift, (_, scale) = pull @ steps, axes(old.covariance)
    # Of pairs with random ranks, it would have this variance.
    usual = math.sqrt(float(pull.square().sum()) * len(steps) / (len(steps) - 1))
    step_path, step, _ = _step_after(old, shift / scale / usual, mass)
    path = (1 - c_path) * old.path + math.sqrt(c_path * (2 - c_path)) * shift / usual
    many = weights @ steps[: len(weights)].square()
    covariance = (1 - c_one - c_many) * old.covariance + c_one * path.square() + c_many * many
    mean = old.mean + shift * old.step
    return Distribution(mean, step, covariance, path, step_path, old.updates + 1)


def _step_after(old: Distribution, white: Tensor, mass: float) -> tuple[Tensor, float, float]:
    """The path of the step size after a shift (n,), the step size, and the path's length.

    The shift would be standard normal if fitness were chance, and lengths are in units of what they
    would be then.
    """
    n, c_step = len(white), _step_rate(len(white), mass)
    path = (1 - c_step) * old.step_path + math.sqrt(c_step * (2 - c_step)) * white
    usual = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))  # E|N(0, I)|
    length = float(path.norm()) / usual
    damping = 1 + 2 * max(0.0, math.sqrt((mass - 1) / (n + 1)) - 1) + c_step
    return path, old.step * math.exp(min(1.0, (c_step / damping) * (length - 1))), length


def _step_rate(n: int, mass: float) -> float:
    """The learning rate of the step size's path."""
    return (mass + 2) / (n + mass + 5)


def recombination_weights(count: int) -> Tensor:
    """(μ,) positive weights of the better half of `count` samples; their sum is 1."""
    ranks = torch.arange(1, count // 2 + 1, dtype=torch.float64)
    weights = math.log((count + 1) / 2) - ranks.log()
    return weights / weights.sum()


def _doubts(count: int) -> Tensor:
    """(λ - μ,) weights of the worse half of `count` samples, the worst one last; their sum is 1."""
    ranks = torch.arange(count // 2 + 1, count + 1, dtype=torch.float64)
    doubts = (ranks.log() - math.log((count + 1) / 2)).clamp_min(0)  # only rounding is below
    return doubts / doubts.sum()


def _pull(count: int) -> Tensor:
    """(λ,) by how much samples move the mean, the best one first; their sum is 0.

    They are expected values of order statistics (Blom, "Statistical Estimates and Transformed
    Beta-Variables", 1958), whose sizes sum to 1. So steps of the mean are half as large as those by
    the better half alone, which is better under luck.
    """
    place = torch.arange(count, 0, -1, dtype=torch.float64)
    scores = torch.special.ndtri((place - 0.375) / (count + 0.25))
    return scores / scores.abs().sum()


def _covariance_rates(n: int, mass: float) -> tuple[float, float, float]:
    """The rates of the path, and of the rank-one and the rank-μ update (the tutorial's table 1)."""
    c_path = (4 + mass / n) / (n + 4 + 2 * mass / n)
    c_one = 2 / ((n + 1.3) ** 2 + mass)
    c_many = 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass)
    return c_path, c_one, min(1 - c_one, c_many)


def _rate_of_worse(n: int, mass: float, mass_of_worse: float) -> float:
    """The rate by which worse samples lower variances (the tutorial's equations 50 to 53)."""
    _, c_one, c_many = _covariance_rates(n, mass)
    by_mass = c_many * (1 + 2 * mass_of_worse / (mass + 2))
    return min(c_one + c_many, by_mass, (1 - c_one - c_many) / n)
