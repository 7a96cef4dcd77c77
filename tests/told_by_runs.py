"""What rollouts and trials came to, as tensors by their names."""

from typing import Any

from torch import Tensor


def tensors_of(runs: Any) -> dict[str, Tensor]:
    """What it says of lanes; returns are missing where an environment gives no rewards."""
    return {name: value for name, value in vars(runs).items() if isinstance(value, Tensor)}
