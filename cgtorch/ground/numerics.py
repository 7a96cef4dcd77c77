"""Functions that round a number in the same way wherever it is in a tensor.

Torch computes the last few numbers, which do not fill a vector register, by other instructions in
`sigmoid`, `exp2`, `softplus` and `atan2`, though not in `exp`, `sin` and `cos`.
"""

import torch
from torch import Tensor


def sigmoid(x: Tensor) -> Tensor:
    """The logistic function of x (...), of any shape, bit for bit independent of neighbours."""
    return 1 / (1 + torch.exp((-x).clamp_max(80)))  # beyond which gradients would not be finite


_POWERS = (0.00015461445, 0.0013400428, 0.009618057, 0.055503272, 0.24022651, 0.6931472, 1.0)


def exp2(x: Tensor) -> Tensor:
    """2^x to seven digits for x (...) float32, at most 100; `native/engine/draws.h` has the same.

    Torch's own function gives other last digits on CPUs and on GPUs.
    """
    whole = x.round()
    rest, p = x - whole, torch.full_like(x, _POWERS[0])
    for factor in _POWERS[1:]:
        p = p * rest + factor
    return (p.view(torch.int32) + whole.int() * 2**23).view(torch.float32)


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """The angle of vectors (x, y), of the same shape, bit for bit independent of neighbours.

    It uses one thread of torch, since several threads would each have a last few numbers.
    """
    missing = -y.numel() % 32  # which torch computes together at most
    flat = [torch.nn.functional.pad(part.flatten(), (0, missing)) for part in (y, x)]
    return torch.atan2(*flat)[: y.numel()].view(y.shape)


def row_means(x: Tensor) -> Tensor:
    """(P,) means of rows (P, B), independent of the number of rows.

    Four sums, each of every eighth number, are computed side by side, as torch does for rows of
    less than 512, and `native/engine/rollout.c` for all.
    """
    count = x.shape[1]
    lanes = 1 if count < 8 else 8
    groups = count // lanes
    part, rest = x[:, : groups * lanes].unflatten(1, (groups, lanes)), x[:, groups * lanes :]
    sums, even = x.new_zeros(len(x), 4, lanes), groups // 4 * 4
    for begin in range(0, even, 4):
        sums += part[:, begin : begin + 4]
    for group in range(even, groups):
        sums[:, 0] += part[:, group]
    together = sums[:, 0] + sums[:, 1] + sums[:, 2] + sums[:, 3]
    total = x.new_zeros(len(x))
    for column in (*rest.unbind(1), *together.unbind(1)):
        total = total + column
    return total / count
