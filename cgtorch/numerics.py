"""Functions of numbers that round a number the same wherever it stands in a tensor.

Torch computes the last few numbers of a tensor, those that do not fill a vector register, with
other instructions in `sigmoid`, `exp2`, `softplus` and `atan2`, not in `exp`, `sin` and `cos`.
"""

import torch
from torch import Tensor


def sigmoid(x: Tensor) -> Tensor:
    """The logistic function of x, any shape, bit for bit the same in whatever company.

    The bound, past which the result is 0 in all but name, keeps gradients finite.
    """
    return 1 / (1 + torch.exp((-x).clamp_max(80)))


_FILLED = 32  # numbers that torch computes together at most


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """The angle of vectors (x, y), of the same shape, bit for bit the same in whatever company.

    On one thread of torch's; where more share the numbers out, each of them has a last few.
    """
    missing = -y.numel() % _FILLED
    flat = [torch.nn.functional.pad(part.flatten(), (0, missing)) for part in (y, x)]
    return torch.atan2(*flat)[: y.numel()].view(y.shape)
