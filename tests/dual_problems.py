"""Dual problems of C-SVC and epsilon-SVR by themselves, without a machine."""

import torch
from torch import Tensor

from cgtorch.svm.problems import Problems, State


def ones(*shape: int) -> Tensor:
    """Ones in double precision."""
    return torch.ones(shape, dtype=torch.float64)


def rows(seed: int, n: int, duplicates: bool = False) -> Tensor:
    """Normal rows (n, 5); with `duplicates`, every second one comes twice."""
    x = torch.randn(n, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return x[torch.arange(n) % (n // 2 + 1)] if duplicates else x


def dual_problems(
    z: Tensor, cap: Tensor | float, epsilon: float | None = None, weight: Tensor | None = None
) -> Problems:
    """A problem for each C (P,), of targets z (n,), or of their signs without an epsilon.

    The weights (P, n) of rows are factors on C, 0 where a row is held out.
    """
    cap = cap * ones(1)
    width = cap[:, None] * (ones(len(z)) if weight is None else weight)
    z = (torch.where(z > 0, 1.0, -1.0).double() if epsilon is None else z).repeat(len(cap), 1)
    lower, upper = -width, width
    if epsilon is None:
        lower, upper = lower * (z < 0), upper * (z > 0)
    return Problems(z, lower, upper, (epsilon or 0.0) * torch.ones_like(cap), cap)


def wrong(problems: Problems, beta: Tensor, matrix: Tensor) -> Tensor:
    """What a step up gains more than a step down costs (P,), from the definition."""
    slope, tube = problems.z - beta @ matrix, problems.epsilon[:, None]
    up = slope - torch.where(beta >= 0, tube, -tube)
    down = slope - torch.where(beta > 0, tube, -tube)
    up = up.masked_fill(beta >= problems.upper, -torch.inf).amax(1)
    return up - down.masked_fill(beta <= problems.lower, torch.inf).amin(1)


def assert_feasible(problems: Problems, found: State) -> None:
    """Coefficients are in their boxes and sum to 0."""
    assert bool((found.beta >= problems.lower).all())
    assert bool((found.beta <= problems.upper).all())
    assert float((found.beta.sum(1).abs() / problems.cap).max()) <= 1e-7
