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
