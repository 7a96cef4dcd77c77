"""Confidence intervals of shares, and whether a model's successor is good enough."""

from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def wilson(successes: int, tried: int, confidence: float) -> tuple[float, float]:
    """The two-sided confidence interval of a share (Wilson 1927).

    Without tries, it is that of one failure.
    """
    n, z = max(1, tried), NormalDist().inv_cdf((1 + confidence) / 2)
    rate = successes / n
    centre = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z * sqrt(rate * (1 - rate) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True)
class Acceptance:
    """The comparison of a model with its successor on held-out data.

    Attributes:
        accepted: Whether the successor replaces the model.
        rows: Number of rows compared.
        before: Mean error of the model.
        after: Mean error of its successor.
        tolerance: How much `after` may exceed `before`: two standard errors of the difference.
    """

    accepted: bool
    rows: int
    before: float
    after: float
    tolerance: float

    @property
    def reason(self) -> str:
        """The comparison in words."""
        said = "taken" if self.accepted else "refused"
        return (
            f"{said}: error {self.after:.4f} after {self.before:.4f} on {self.rows} earlier rows "
            f"held out, tolerance {self.tolerance:.4f}"
        )


def accept_model(before: "Tensor", after: "Tensor") -> Acceptance:
    """Accept a successor unless its errors (n,) are worse by more than the comparison's noise.

    That is two standard errors of the mean of the row-wise differences: one in forty equally good
    successors is refused, and many small losses cannot add up. Without rows it is accepted.
    """
    rows = len(before)
    if rows < 2:
        return Acceptance(True, rows, float(before.sum()), float(after.sum()), 0.0)
    loss = after - before
    tolerance = 2 * float(loss.std() / rows**0.5)
    accepted = float(loss.mean()) <= tolerance
    return Acceptance(accepted, rows, float(before.mean()), float(after.mean()), tolerance)
