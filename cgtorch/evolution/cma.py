"""CMA-ES (Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772), with its constants.

Of many parameters, only the variances are learned, as in sep-CMA-ES (Ros and Hansen, "A simple
modification in CMA-ES achieving linear time and space complexity", PPSN 2008).
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
    """(count, n) float32 samples."""
    normal = torch.randn(count, len(distribution.mean), generator=generator).double()
    basis, scale = axes(distribution.covariance)
    moved = normal * scale if basis is None else (normal * scale) @ basis.T
    return (distribution.mean + distribution.step * moved).float()


def axes(covariance: Tensor) -> tuple[Tensor | None, Tensor]:
    """Principal axes (n, n), or None for a diagonal covariance, and standard deviations (n,)."""
    if covariance.dim() == 1:
        return None, covariance.clamp_min(LEAST_VARIANCE).sqrt()
    variance, basis = torch.linalg.eigh(covariance)
    return basis, variance.clamp_min(LEAST_VARIANCE).sqrt()


def updated(distribution: Distribution, samples: Tensor, fitness: Tensor) -> Distribution:
    """The distribution after an update by samples (λ, n) and their fitness (λ,); more is better."""
    old, n, separable = distribution, len(distribution.mean), distribution.covariance.dim() == 1
    weights = _weights(len(samples))
    mass = 1 / float(weights.square().sum())  # μ_eff
    c_step = (mass + 2) / (n + mass + 5)
    c_path = (4 + mass / n) / (n + 4 + 2 * mass / n)
    c_one, c_many = _covariance_rates(n, mass, separable)
    order = fitness.argsort(descending=True, stable=True)[: len(weights)]
    steps = (samples.double()[order] - old.mean) / old.step
    shift = weights @ steps
    basis, scale = axes(old.covariance)
    white = shift / scale if basis is None else basis @ ((basis.T @ shift) / scale)
    step_path = (1 - c_step) * old.step_path + math.sqrt(c_step * (2 - c_step) * mass) * white
    usual = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))  # E|N(0, I)|
    length, updates = float(step_path.norm()), old.updates + 1
    grown = math.sqrt(1 - (1 - c_step) ** (2 * updates))
    calm = float(length / grown < (1.4 + 2 / (n + 1)) * usual)
    path = (1 - c_path) * old.path + calm * math.sqrt(c_path * (2 - c_path) * mass) * shift
    kept = 1 - c_one - c_many + (1 - calm) * c_one * c_path * (2 - c_path)
    if separable:
        rank_one, rank_many = path.square(), weights @ steps.square()
    else:
        rank_one, rank_many = path.outer(path), (steps.T * weights) @ steps
    covariance = kept * old.covariance + c_one * rank_one + c_many * rank_many
    damping = 1 + 2 * max(0.0, math.sqrt((mass - 1) / (n + 1)) - 1) + c_step
    change = (c_step / damping) * (length / usual - 1)
    step = old.step * math.exp(min(1.0, change))
    return Distribution(old.mean + shift * old.step, step, covariance, path, step_path, updates)


def _weights(count: int) -> Tensor:
    """(μ,) positive weights of the better half of `count` samples; their sum is 1."""
    ranks = torch.arange(1, count // 2 + 1, dtype=torch.float64)
    weights = math.log((count + 1) / 2) - ranks.log()
    return weights / weights.sum()


def _covariance_rates(n: int, mass: float, separable: bool) -> tuple[float, float]:
    """The learning rates of the rank-one and the rank-μ update (the tutorial's table 1)."""
    c_one = 2 / ((n + 1.3) ** 2 + mass)
    c_many = 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass)
    if separable:
        c_one, c_many = min(1.0, c_one * (n + 2) / 3), c_many * (n + 2) / 3
    return c_one, min(1 - c_one, c_many)
