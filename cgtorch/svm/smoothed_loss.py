"""The epsilon-insensitive and the hinge loss with their corners rounded over a width h C.

Rounding the primal's loss adds a ridge h to the dual's kernel matrix (Chapelle 2007): the
coefficient that a residual r asks for, the slope of the loss, is soft(r, epsilon) / h clipped to
the coefficient's box. Everything a Newton method needs follows from that.
"""

import torch
from torch import Tensor

from cgtorch.svm.problems import Problems

# Status of a coefficient: on a bound (-2 lower, 0 zero, 2 upper) or free (-1 below, 1 above zero).
# Statuses are floating point numbers, because arithmetic on them is faster than choosing.


def soft(r: Tensor, width: Tensor) -> Tensor:
    """Soft threshold (P, n): r moved towards 0 by `width` (P,), and 0 within it."""
    return r - torch.maximum(torch.minimum(r, width[:, None]), -width[:, None])


def slope(problems: Problems, h: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
    """The coefficients (P, n) that residuals ask for, before and after clipping to the boxes."""
    value = soft(residual, problems.epsilon) / h[:, None]
    return value, torch.minimum(torch.maximum(value, problems.lower), problems.upper)


def statuses(value: Tensor, clipped: Tensor) -> Tensor:
    """Statuses (P, n) of coefficients before and after clipping, as `slope` gives them."""
    return clipped.sign() * (2 - (value == clipped).to(value))


def classify(beta: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Statuses (P, n) that coefficients in their boxes show; those on a bound stay there."""
    return beta.sign() * (1 + ((beta >= upper) | (beta <= lower)).to(beta))


def on_bounds(problems: Problems, status: Tensor) -> Tensor:
    """The bound (P, n) of every coefficient that has one by its status, 0 for the others."""
    upper, lower = (status - 1).clamp_min(0), (-1 - status).clamp_min(0)
    return upper * problems.upper + lower * problems.lower


def line_search(
    problems: Problems,
    h: Tensor,
    residual: Tensor,
    change: Tensor,
    linear: Tensor,
    square: Tensor,
    begin: Tensor,
) -> Tensor:
    """Steps (P,) below 1 that minimise the rounded primal along a Newton direction.

    The derivative along the step t is linear + t square - slope(residual - t change)' change, which
    only grows with t, so bisection finds its zero; a tenth of the first derivative is near enough.

    Args:
        problems: The problems, each with a derivative below 0 at t = 0 and above 0 at t = 1.
        h: Ridges (P,).
        residual: Residuals at t = 0 (P, n).
        change: Fall of the residuals at t = 1 (P, n).
        linear: beta' K d of the direction d (P,).
        square: d' K d (P,).
        begin: Derivatives at t = 0 (P,).
    """
    low, high = torch.zeros_like(h), torch.ones_like(h)
    for _ in range(12):
        t = (low + high) / 2
        clipped = slope(problems, h, residual - t[:, None] * change)[1]
        derivative = linear + t * square - (clipped * change).sum(1)
        if bool((derivative.abs() <= 0.1 * begin.abs()).all()):
            return t
        before = derivative < 0
        low, high = torch.where(before, t, low), torch.where(before, high, t)
    return torch.where(low > 0, low, high)
