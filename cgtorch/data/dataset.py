"""What the robot has experienced, as tensors in one safetensors file."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor


@dataclass(frozen=True)
class Dataset:
    """Transitions for Γ and grasp results for C.

    Attributes:
        percept: (N, D) p.
        motion: (N, U) u.
        next_percept: (N, D) p′.
        grasp_percept: (L, D).
        graspable: (L,) bool.
    """

    percept: Tensor
    motion: Tensor
    next_percept: Tensor
    grasp_percept: Tensor
    graspable: Tensor

    def extended(self, more: "Dataset") -> "Dataset":
        """Both datasets, the rows of `more` last."""
        return Dataset(
            *(torch.cat([getattr(self, f.name), getattr(more, f.name)]) for f in fields(self))
        )

    def whole(self, percept_size: int | None = None) -> bool:
        """Whether the tensors, which may be anything, fit one another and are finite.

        Args:
            percept_size: D; whatever it is, if not given.
        """
        n, d = (*self.percept.shape, 0, 0)[:2]
        return (
            self.percept.shape == self.next_percept.shape == (n, d)
            and d == (d if percept_size is None else percept_size)
            and self.motion.dim() == 2
            and len(self.motion) == n
            and self.grasp_percept.dim() == 2
            and self.grasp_percept.shape[1] == d
            and self.graspable.shape == self.grasp_percept.shape[:1]
            and self.graspable.dtype == torch.bool
            and all(
                x.dtype == torch.float32 and bool(x.isfinite().all())
                for x in (self.percept, self.motion, self.next_percept, self.grasp_percept)
            )
        )
