"""The dual problems of C-SVC and epsilon-SVR by themselves, without a machine."""

import torch
from torch import Tensor

from cgtorch.svm.problems import Problems


def classification(signs: Tensor, cap: Tensor, weight: Tensor) -> Problems:
    """C-SVC problems of signs (n,), each with its C (P,).

    The weights (P, n) of rows are factors on C, 0 where a row is held out.
    """
    width = cap[:, None] * weight
    return Problems(
        z=signs.expand(len(cap), -1).contiguous(),
        lower=-width * (signs < 0),
        upper=width * (signs > 0),
        epsilon=torch.zeros_like(cap),
        cap=cap,
    )


def regression(targets: Tensor, cap: Tensor, epsilon: Tensor, weight: Tensor) -> Problems:
    """epsilon-SVR problems of targets (P, n), with their C (P,) and half widths of the tube (P,).

    The weights (P, n) of rows are factors on C, 0 where a row is held out.
    """
    width = cap[:, None] * weight
    return Problems(z=targets, lower=-width, upper=width, epsilon=epsilon, cap=cap)
