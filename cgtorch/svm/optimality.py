"""How near coefficients are to solving their dual problems."""

import torch
from torch import Tensor

from cgtorch.svm.problems import Problems, State


def violation(problems: Problems, beta: Tensor, residual: Tensor) -> Tensor:
    """The largest distance (...) of residuals z - K beta - bias (..., n) from what beta allows."""
    width = problems.epsilon[..., None]
    most = torch.where(beta >= 0, width, -width).masked_fill(beta >= problems.upper, torch.inf)
    least = torch.where(beta <= 0, -width, width).masked_fill(beta <= problems.lower, -torch.inf)
    return torch.maximum(residual - most, least - residual).amax(-1).clamp_min(0)


def duality_gap(problems: Problems, found: State) -> Tensor:
    """Primal minus dual objective (P,) at feasible coefficients.

    It is a sum of one non-negative term per row, u max(0, r - e) - l max(0, -r - e) - r b + e |b|
    with residual r = z - K beta - bias, so it shows where a solution is not optimal.
    """
    residual = problems.z - found.product - found.bias[:, None]
    width = problems.epsilon[:, None]
    loss = problems.upper * (residual - width).clamp_min(0)
    loss = loss - problems.lower * (-residual - width).clamp_min(0)
    return (loss - residual * found.beta + width * found.beta.abs()).sum(1)


def dual_objective(problems: Problems, found: State) -> Tensor:
    """The minimised function (P,), with its sign."""
    linear = (0.5 * found.product - problems.z) * found.beta
    return (linear + problems.epsilon[:, None] * found.beta.abs()).sum(1)


def relative_gap(problems: Problems, found: State) -> Tensor:
    """Duality gaps (P,) as shares of the objectives."""
    objective = dual_objective(problems, found).abs().clamp_min(1e-12)
    return duality_gap(problems, found) / objective


def middle_bias(problems: Problems, found: State) -> Tensor:
    """Biases (P,), in the middle of what is optimal where no free coefficient fixes them.

    That is libsvm's rule (Chang & Lin 2011, section 4.1.5).
    """
    beta, box = found.beta, torch.maximum(problems.upper, -problems.lower) * 1e-9
    inside = (beta < problems.upper - box) & (beta > problems.lower + box) & (beta.abs() > box)
    width = problems.epsilon[:, None]
    gradient = problems.z - found.product
    rise = gradient - torch.where(beta >= -box, width, -width)
    fall = gradient - torch.where(beta > box, width, -width)
    low = rise.masked_fill(beta >= problems.upper - box, -torch.inf).amax(1)
    high = fall.masked_fill(beta <= problems.lower + box, torch.inf).amin(1)
    middle = (low + high) / 2
    return torch.where(inside.any(1) | ~torch.isfinite(middle), found.bias, middle)
