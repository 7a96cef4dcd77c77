"""The dual problems of C-SVC and epsilon-SVR as batches of boxes and targets.

Both are min 1/2 beta' K beta - z' beta + epsilon |beta|_1 with lower <= beta <= upper and
1' beta = 0 (Chang & Lin 2011, eq. 2 and 10); a row held out for validation has the box [0, 0].
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Problems:
    """A batch of P dual problems over the same n rows.

    Attributes:
        z: Targets (P, n).
        lower: Lower ends of the boxes (P, n), at most 0.
        upper: Upper ends of the boxes (P, n), at least 0.
        epsilon: Half widths of the insensitive tube (P,).
        cap: The C of each problem (P,), the scale of its ridge.
    """

    z: Tensor
    lower: Tensor
    upper: Tensor
    epsilon: Tensor
    cap: Tensor

    def take(self, index: Tensor) -> "Problems":
        """The problems of `index` (Q,)."""
        return Problems(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def rows(self, index: Tensor, scale: float) -> "Problems":
        """The same problems on the rows of `index` with boxes `scale` times as wide."""
        return Problems(
            self.z[:, index],
            self.lower[:, index] * scale,
            self.upper[:, index] * scale,
            self.epsilon,
            self.cap * scale,
        )


def classification(signs: Tensor, cap: Tensor, weight: Tensor) -> Problems:
    """C-SVC problems.

    Args:
        signs: Labels -1 and 1 (n,), float64.
        cap: The C of each problem (P,).
        weight: Weight of each row in each problem (P, n), 0 where it is held out.
    """
    width = cap[:, None] * weight
    return Problems(
        z=signs.expand(len(cap), -1).contiguous(),
        lower=-width * (signs < 0),
        upper=width * (signs > 0),
        epsilon=torch.zeros_like(cap),
        cap=cap,
    )


def regression(targets: Tensor, cap: Tensor, epsilon: Tensor, weight: Tensor) -> Problems:
    """epsilon-SVR problems.

    Args:
        targets: Targets of each problem (P, n), float64.
        cap: The C of each problem (P,).
        epsilon: Half width of the tube of each problem (P,).
        weight: Weight of each row in each problem (P, n), 0 where it is held out.
    """
    width = cap[:, None] * weight
    return Problems(z=targets, lower=-width, upper=width, epsilon=epsilon, cap=cap)


def inside(problems: Problems, beta: Tensor) -> Tensor:
    """Coefficients (P, n) clipped to their boxes."""
    return torch.minimum(torch.maximum(beta, problems.lower), problems.upper)


def violation(problems: Problems, beta: Tensor, residual: Tensor) -> Tensor:
    """The largest distance (P,) of residuals z - K beta - bias (P, n) from what beta allows."""
    width = problems.epsilon[:, None]
    most = torch.where(beta >= 0, width, -width).masked_fill(beta >= problems.upper, torch.inf)
    least = torch.where(beta <= 0, -width, width).masked_fill(beta <= problems.lower, -torch.inf)
    return torch.maximum(residual - most, least - residual).amax(1).clamp_min(0)
