"""Eq. 2: how strategies drift."""

import math

import pytest
import torch
from support import seeded
from torch import Generator, Tensor

from cgtorch.evolution import STRATEGY
from cgtorch.evolution.population import PROBABILITY_MAX, SIGMA_MAX, STRATEGY_MIN, drifted, factors
from cgtorch.ground.counter_rng import keys, random_key


def drift(strategy: Tensor, tau: float, generator: Generator) -> Tensor:
    own = keys(random_key(generator), len(strategy))
    return drifted(strategy, factors(own, tau))


def test_drift_is_log_normal_with_variance_tau() -> None:
    strategy: Tensor = torch.full((20_000, len(STRATEGY)), 0.05)
    for tau in (0.01, 0.05):
        log = (drift(strategy, tau, seeded(0)) / strategy).log()
        assert log.mean().item() == pytest.approx(0, abs=0.002)
        assert log.var().item() == pytest.approx(tau, rel=0.02)
        within = (log.abs() < tau**0.5).float().mean()
        assert within == pytest.approx(math.erf(0.5**0.5), abs=0.005)
        together = torch.corrcoef(log.T) - torch.eye(len(STRATEGY))
        assert together.abs().max() < 0.05  # every parameter drifts by itself


def test_drift_without_variance_changes_nothing() -> None:
    strategy = torch.rand(50, len(STRATEGY)).clamp_min(STRATEGY_MIN)
    assert torch.equal(drift(strategy, 0.0, seeded(0)), strategy)


def test_drift_stays_within_its_bounds() -> None:
    strategy = torch.full((50, len(STRATEGY)), 0.5)
    generator = seeded(0)
    for _ in range(200):
        strategy = drift(strategy, 1.0, generator)
        assert strategy.min() >= STRATEGY_MIN
        assert strategy[:, :-1].max() <= PROBABILITY_MAX
        assert strategy[:, -1].max() <= SIGMA_MAX
    assert STRATEGY[-1] == "sigma"
    assert strategy[:, -1].max() > PROBABILITY_MAX
