"""Functions that round a number in the same way wherever it is in a tensor.

Torch computes the last few numbers of a tensor, which do not fill a vector register, by other
instructions in `sigmoid`, `exp2`, `softplus` and `atan2`, though not in `exp`, `sin` and `cos`.
"""

import torch
from torch import Tensor


def sigmoid(x: Tensor) -> Tensor:
    """The logistic function of x (...), of any shape, bit for bit independent of neighbours.

    A bound, beyond which the result is practically 0, keeps gradients finite.
    """
    return 1 / (1 + torch.exp((-x).clamp_max(80)))


_POWERS = (0.00015461445, 0.0013400428, 0.009618057, 0.055503272, 0.24022651, 0.6931472, 1.0)


def exp2(x: Tensor) -> Tensor:
    """2^x to seven digits for x (...) float32, at most 100; `native/engine/draws.h` has the same.

    Torch's own function gives other last digits on CPUs and on GPUs. The polynomial is close to the
    best of its degree.
    """
    whole = x.round()
    rest, p = x - whole, torch.full_like(x, _POWERS[0])
    for factor in _POWERS[1:]:
        p = p * rest + factor
    return (p.view(torch.int32) + whole.int() * 2**23).view(torch.float32)


_FILLED = 32  # numbers that torch computes together at most


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """The angle of vectors (x, y), of the same shape, bit for bit independent of neighbours.

    It uses one thread of torch, since several threads would each have a last few numbers.
    """
    missing = -y.numel() % _FILLED
    flat = [torch.nn.functional.pad(part.flatten(), (0, missing)) for part in (y, x)]
    return torch.atan2(*flat)[: y.numel()].view(y.shape)


_LANES, _SUMS = 8, 4


def row_means(x: Tensor) -> Tensor:
    """(P,) means of rows (P, B), independent of the number of rows.

    Four sums, each of every eighth number, are computed side by side, as torch does for rows of
    less than 512, and `native/engine/rollout.c` for all.
    """
    count = x.shape[1]
    lanes = 1 if count < _LANES else _LANES
    groups = count // lanes
    part, rest = x[:, : groups * lanes].unflatten(1, (groups, lanes)), x[:, groups * lanes :]
    sums, even = x.new_zeros(len(x), _SUMS, lanes), groups // _SUMS * _SUMS
    for begin in range(0, even, _SUMS):
        sums += part[:, begin : begin + _SUMS]
    for group in range(even, groups):
        sums[:, 0] += part[:, group]
    together = sums[:, 0] + sums[:, 1] + sums[:, 2] + sums[:, 3]
    total = x.new_zeros(len(x))
    for column in (*rest.unbind(1), *together.unbind(1)):
        total = total + column
    return total / count
