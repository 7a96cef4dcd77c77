"""Functions of numbers that round a number the same wherever it stands in a tensor.

Torch computes the last few numbers of a tensor, those that do not fill a vector register, with
other instructions in `sigmoid`, `exp2`, `softplus` and `atan2`, not in `exp`, `sin` and `cos`.
"""

import torch
from torch import Tensor


def sigmoid(x: Tensor) -> Tensor:
    """The logistic function of x (...), any shape, bit for bit the same in whatever company.

    The bound, past which the result is 0 in all but name, keeps gradients finite.
    """
    return 1 / (1 + torch.exp((-x).clamp_max(80)))


_POWERS = (0.00015461445, 0.0013400428, 0.009618057, 0.055503272, 0.24022651, 0.6931472, 1.0)


def exp2(x: Tensor) -> Tensor:
    """2^x to seven digits of x (...) float32, no larger than 100; `native/engine/draws.h` as well.

    With torch's own, CPUs and GPUs would not agree on last digits. The polynomial is near the best
    of its degree.
    """
    whole = x.round()
    rest, p = x - whole, torch.full_like(x, _POWERS[0])
    for factor in _POWERS[1:]:
        p = p * rest + factor
    return (p.view(torch.int32) + whole.int() * 2**23).view(torch.float32)


_FILLED = 32  # numbers that torch computes together at most


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """The angle of vectors (x, y), of the same shape, bit for bit the same in whatever company.

    On one thread of torch's; where more share the numbers out, each of them has a last few.
    """
    missing = -y.numel() % _FILLED
    flat = [torch.nn.functional.pad(part.flatten(), (0, missing)) for part in (y, x)]
    return torch.atan2(*flat)[: y.numel()].view(y.shape)


_LANES, _SUMS = 8, 4


def row_means(x: Tensor) -> Tensor:
    """(P,) means of rows (P, B), each the same however many rows there are.

    Four sums of every eighth number are made side by side, as torch does for rows of less than 512,
    and `native/engine/rollout.c` for all.
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
