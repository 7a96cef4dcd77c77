"""Data collected in a world, from which Γ and C are learned."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor


@dataclass(frozen=True)
class Dataset:
    """Transitions for Γ and tests of success for C.

    Attributes:
        percept: (N, D) p.
        control: (N, U) u.
        next_percept: (N, D) p′.
        tested: (L, D) percepts at which success was tested.
        succeeded: (L,) bool, the results of these tests.
    """

    percept: Tensor
    control: Tensor
    next_percept: Tensor
    tested: Tensor
    succeeded: Tensor

    def extended(self, more: "Dataset") -> "Dataset":
        """Both datasets, with the rows of `more` last."""
        return Dataset(
            *(torch.cat([getattr(self, f.name), getattr(more, f.name)]) for f in fields(self))
        )

    def whole(self, percept_size: int | None = None) -> bool:
        """Whether untrusted tensors are finite and fit one another, and percepts have D numbers."""
        n, d = (*self.percept.shape, 0, 0)[:2]
        return (
            self.percept.shape == self.next_percept.shape == (n, d)
            and d == (d if percept_size is None else percept_size)
            and self.control.dim() == 2
            and len(self.control) == n
            and self.tested.dim() == 2
            and self.tested.shape[1] == d
            and self.succeeded.shape == self.tested.shape[:1]
            and self.succeeded.dtype == torch.bool
            and all(
                x.dtype == torch.float32 and bool(x.isfinite().all())
                for x in (self.percept, self.control, self.next_percept, self.tested)
            )
        )
