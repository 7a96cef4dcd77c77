"""Whether a model that was trained on more data may replace the one before it."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Acceptance:
    """The comparison of a model with its successor on data that neither was fitted on.

    Attributes:
        accepted: Whether the successor takes over.
        rows: Rows compared on.
        before: Mean error of the model.
        after: Mean error of its successor.
        tolerance: By how much `after` may exceed `before`: two standard errors of the difference.
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


def accept_model(before: Tensor, after: Tensor) -> Acceptance:
    """Accept a successor unless its errors (n,) are worse, by more than the comparison's noise.

    The noise is taken as two standard errors of the mean of the differences, row by row: of equal
    successors one in forty is refused. Where the models answer alike it is nearly zero, so it does
    not let many small losses through. Without rows to compare on the successor is accepted.
    """
    rows = len(before)
    if rows < 2:
        return Acceptance(True, rows, float(before.sum()), float(after.sum()), 0.0)
    loss = after - before
    tolerance = 2 * float(loss.std() / rows**0.5)
    accepted = float(loss.mean()) <= tolerance
    return Acceptance(accepted, rows, float(before.mean()), float(after.mean()), tolerance)
