"""Platt scaling: probabilities from decision values, as libsvm defines them.

Platt, "Probabilistic outputs for support vector machines" (1999), in the stable form of Lin,
Lin & Weng, "A note on Platt's probabilistic outputs for support vector machines" (2007).
"""

import torch
from torch import Tensor

from cgtorch.ground.numerics import sigmoid


def probability(decision: Tensor, slope: Tensor, offset: Tensor) -> Tensor:
    """P(positive | decision) = 1 / (1 + exp(slope decision + offset)), any shape.

    A decision has the same probability, bit for bit, in any batch.
    """
    return sigmoid(-(slope * decision + offset))


def _loss(logit: Tensor, target: Tensor) -> Tensor:
    """Cross entropy (summed) of targets (n,) under 1 / (1 + exp(logit))."""
    return (target * logit + torch.nn.functional.softplus(-logit)).sum()


def fit_platt(decision: Tensor, signs: Tensor) -> tuple[Tensor, Tensor]:
    """Slope () and offset () for held-out decision values (n,) with signs (n,), float64.

    Newton's method with backtracking on the regularised targets (N+ + 1) / (N+ + 2) and 1 / (N- +
    2) (Lin, Lin & Weng 2007, algorithm 1).
    """
    f = decision.double()
    positive = signs > 0
    n_positive, n_negative = int(positive.sum()), int((~positive).sum())
    target = torch.where(positive, (n_positive + 1) / (n_positive + 2), 1 / (n_negative + 2))
    target = target.to(f)
    columns = torch.stack([f, torch.ones_like(f)], dim=1)
    start = torch.log(torch.tensor((n_negative + 1) / (n_positive + 1), dtype=torch.float64))
    theta = torch.stack([torch.zeros_like(start), start]).to(f.device)
    loss = _loss(columns @ theta, target)
    for _ in range(100):
        p = sigmoid(-(columns @ theta))
        gradient = columns.T @ (target - p)
        if float(gradient.abs().max()) < 1e-9 * len(f):
            break
        hessian = columns.T @ (columns * (p * (1 - p))[:, None])
        hessian.diagonal().add_(1e-12)
        step = -torch.linalg.solve(hessian, gradient)
        slope = float(gradient @ step)
        size = 1.0
        while size > 1e-10:
            attempt = theta + size * step
            value = _loss(columns @ attempt, target)
            if float(value) < float(loss) + 1e-4 * size * slope:
                break
            size /= 2
        else:
            break
        theta, loss = attempt, value
    return theta[0], theta[1]
