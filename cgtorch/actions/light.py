"""Network layers for CMA-ES, with scaled-down weights and, even more so, biases."""

from torch import Tensor

WEIGHT, BIAS = 0.5, 0.01
"""The factors of weights and biases; `native/engine/memory.h` has the same."""


def light_layer(x: Tensor, weights: Tensor, biases: Tensor) -> Tensor:
    """Outputs (n, units): matrices (n, units * inputs) times x (n, inputs), and biases (n, units).

    The parameters of a node are standard normal, as for any action. Weights count half of their
    parameters, and biases a hundredth: the constant input 1 of a bias is far larger than a percept
    near its goal.
    """
    rows = weights.unflatten(-1, (biases.shape[-1], x.shape[-1]))
    return WEIGHT * (rows * x[..., None, :]).sum(-1) + BIAS * biases
