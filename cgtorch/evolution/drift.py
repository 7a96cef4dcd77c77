"""How the strategy of an individual drifts (eq. 2)."""

import math
from functools import cache

import torch
from torch import Generator, Tensor

from cgtorch.evolution.population import STRATEGY

TAU = 0.05  # variance of the drift in eq. 2
STRATEGY_MIN, PROBABILITY_MAX, SIGMA_MAX = 1e-3, 1.0, 10.0


def factors(count: int, tau: float, generator: Generator) -> Tensor:
    """(count, S) exp(N(0, τ)) of eq. 2, with variance τ."""
    noise = torch.randn((count, len(STRATEGY)), generator=generator)
    # exp of so few numbers already goes to all threads
    return noise.mul_(tau**0.5 / math.log(2)).exp2_()


def drifted(strategy: Tensor, factors: Tensor) -> Tensor:
    """Eq. 2, (P, S) s ← s exp(N(0, τ)), within bounds that keep every rate alive."""
    least, most = bounds()
    return torch.minimum(torch.maximum(strategy * factors, least), most)


@cache
def bounds() -> Tensor:
    """(2, S) the least and the most that each strategy parameter may be."""
    least, most = torch.full((2, len(STRATEGY)), STRATEGY_MIN).unbind()
    most.fill_(PROBABILITY_MAX)[STRATEGY.index("sigma")] = SIGMA_MAX
    return torch.stack([least, most])
