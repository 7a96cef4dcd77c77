"""What rollouts and trials came to, as tensors by their names."""

from typing import Any

from torch import Tensor


def tensors_of(runs: Any) -> dict[str, Tensor]:
    """All of it; returns are missing where an environment gives no rewards."""
    return {name: value for name, value in vars(runs).items() if value is not None}
