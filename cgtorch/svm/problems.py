"""The dual problems of C-SVC and epsilon-SVR as batches, and measures of optimality.

Both are min 1/2 beta' K beta - z' beta + epsilon |beta|_1 with lower <= beta <= upper and 1' beta =
0 (Chang & Lin 2011, eq. 2 and 10). A row held out for validation has the box [0, 0].
"""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor


@dataclass(frozen=True)
class Targets:
    """The targets of k outputs on n rows, and their form in the solver.

    The problem of (y - mean) / unit, C / unit and epsilon / unit has the coefficients beta / unit,
    so that the solver's tolerances do not depend on the unit of the targets.

    Attributes:
        y: Targets, or the signs -1 and 1 of two classes (k, n).
        z: (y - mean) / unit (k, n).
        mean: Of the targets (k,), 0 for signs.
        unit: A power of two near the standard deviation of the targets (k,), 1 for signs.
        classes: The two labels of the signs (2,), None for a regression.
        single: Whether there is one output that was given as (n,).
    """

    y: Tensor
    z: Tensor
    mean: Tensor
    unit: Tensor
    classes: Tensor | None
    single: bool

    def restored(self, values: Tensor) -> Tensor:
        """Values (..., k, n) of the solver in the unit of the targets."""
        return values * self.unit[:, None] + self.mean[:, None]


@dataclass(frozen=True)
class Batch:
    """Tensors whose first axis is that of P problems."""

    def take(self, index: Tensor | int) -> Self:
        """The problems `index` (Q,), or a single one without that axis."""
        return type(self)(*(value[index] for value in vars(self).values()))

    def put(self, index: Tensor | int, other: Self) -> None:
        """Write the problems of another batch to `index` (Q,)."""
        for name, value in vars(self).items():
            value[index] = getattr(other, name)

    def to(self, device: torch.device) -> Self:
        """The same batch on a device."""
        return type(self)(*(value.to(device) for value in vars(self).values()))


@dataclass(frozen=True)
class Problems(Batch):
    """P dual problems over the same n rows: targets z (P, n) and costs `cap` (P,).

    The boxes reach from `lower` (P, n), at most 0, to `upper` (P, n), at least 0. The half widths
    of the tubes are `epsilon` (P,).
    """

    z: Tensor
    lower: Tensor
    upper: Tensor
    epsilon: Tensor
    cap: Tensor

    @property
    def reach(self) -> Tensor:
        """The largest coefficient (P,) that the boxes of a problem allow."""
        return torch.maximum(self.upper, -self.lower).amax(-1)


@dataclass(frozen=True)
class State(Batch):
    """The state of P problems over n rows, or their solution.

    Coefficients `beta` (P, n) are in their boxes, with sum 0. The `product` K beta (P, n) has no
    biases (P,). The largest violation (P,) of the optimality conditions is that of libsvm.
    """

    beta: Tensor
    product: Tensor
    bias: Tensor
    violation: Tensor


def at_zero(problems: Problems) -> State:
    """The start at zero."""
    zero, unknown = torch.zeros_like(problems.z), torch.full_like(problems.cap, torch.inf)
    return State(zero, zero.clone(), torch.zeros_like(unknown), unknown)


def inside(problems: Problems, beta: Tensor) -> Tensor:
    """Coefficients (..., n) clipped to their boxes."""
    return torch.minimum(torch.maximum(beta, problems.lower), problems.upper)


def feasible(problems: Problems, beta: Tensor) -> Tensor:
    """The feasible point (P, n) nearest to `beta` (P, n): clip(beta - shift) with sum 0."""
    low = (beta - problems.upper).amin(-1, keepdim=True)
    high = (beta - problems.lower).amax(-1, keepdim=True)
    for _ in range(100):
        middle = (low + high) / 2
        above = inside(problems, beta - middle).sum(-1, keepdim=True) > 0
        low, high = torch.where(above, middle, low), torch.where(above, high, middle)
    result = inside(problems, beta - high)
    room = (result > problems.lower) & (result < problems.upper)
    lack = result.sum(-1, keepdim=True) / room.sum(-1, keepdim=True).clamp_min(1)
    return inside(problems, torch.where(room, result - lack, result))


def violation(problems: Problems, beta: Tensor, residual: Tensor) -> Tensor:
    """The largest distance (...) of residuals z - K beta - bias (..., n) from what beta allows."""
    width = problems.epsilon[..., None]
    most = torch.where(beta >= 0, width, -width).masked_fill(beta >= problems.upper, torch.inf)
    least = torch.where(beta <= 0, -width, width).masked_fill(beta <= problems.lower, -torch.inf)
    return torch.maximum(residual - most, least - residual).amax(-1).clamp_min(0)


def duality_gap(problems: Problems, found: State) -> Tensor:
    """Primal minus dual objective (P,) at feasible coefficients.

    It sums a non-negative term per row, u max(0, r - e) - l max(0, -r - e) - r b + e |b| with the
    residual r = z - K beta - bias.
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
    """Duality gaps (P,) as shares of the objectives, of which outliers count like other rows.

    As z has the unit 1, an objective is at most the sum of the boxes' widths, but for outliers.
    """
    most = (problems.upper - problems.lower).sum(1)
    objective = dual_objective(problems, found).abs()
    return duality_gap(problems, found) / objective.clamp(1e-12 * most, most)


def middle_bias(problems: Problems, found: State) -> Tensor:
    """Biases (P,), in the middle of the optimal ones if not unique (Chang & Lin 2011, 4.1.5)."""
    beta, bound = found.beta, torch.maximum(problems.upper, -problems.lower)
    box = torch.minimum(bound, found.beta.abs().amax(1, keepdim=True)) * 1e-9
    free = (beta < problems.upper - box) & (beta > problems.lower + box) & (beta.abs() > box)
    width = problems.epsilon[:, None]
    gradient = problems.z - found.product
    rise = gradient - torch.where(beta >= -box, width, -width)
    fall = gradient - torch.where(beta > box, width, -width)
    low = rise.masked_fill(beta >= problems.upper - box, -torch.inf).amax(1)
    high = fall.masked_fill(beta <= problems.lower + box, torch.inf).amin(1)
    middle = (low + high) / 2
    return torch.where(free.any(1) | ~torch.isfinite(middle), found.bias, middle)
