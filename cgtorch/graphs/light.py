"""Network layers for CMA-ES, with scaled-down weights and, even more so, biases."""

from torch import Tensor

WEIGHT, BIAS = 0.5, 0.01
"""The factors of weights and biases; `native/engine/memory.h` has the same."""


def light_layer(x: Tensor, weights: Tensor, biases: Tensor) -> Tensor:
    """A linear layer with scaled parameters, whose outputs are (n, units).

    It multiplies the matrices `weights` (n, units * inputs) by x (n, inputs) and adds `biases` (n,
    units). The parameters of a node are standard normal, as for any action. They are multiplied by
    0.5 for weights and by 0.01 for biases, because the constant input 1 of a bias is far larger
    than a percept near its goal.
    """
    rows = weights.unflatten(-1, (biases.shape[-1], x.shape[-1]))
    return WEIGHT * (rows * x[..., None, :]).sum(-1) + BIAS * biases
