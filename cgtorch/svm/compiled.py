"""RBF machines as compiled code knows them, and what it says of many rows.

The same numbers as torch's but for the last digits; a row's do not depend on the rows beside it.
"""

import math
from typing import Any

import torch
from torch import Tensor

from cgtorch.native import VECTOR, constants, function, structure, threads

LOG2E = math.log2(math.e)


def machine_structure(centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor) -> Any:
    """An RBF machine of centres (m, d), weights (m, k), bias (k,) and gamma ().

    None where nothing is compiled or there is no room for it.
    """
    (m, d), k = centres.shape, len(bias)
    machine, most = structure("Machine", centres.dtype), constants("machine_limits", centres.dtype)
    if machine is None or not 0 < d <= most["MOST_FEATURES"]:
        return None
    if not 0 < k <= most["MOST_OUTPUTS"] or m == 0:
        return None
    scale, more = math.sqrt(float(gamma) * LOG2E), -m % (VECTOR // centres.element_size())
    scaled = (centres * scale).T
    # Filled up with a centre that is there already, so that no other is nearest; its weight is 0.
    columns = torch.cat([scaled, scaled[:, :1].expand(d, more)], 1)
    rows = torch.cat([weights.T, weights.new_zeros(k, more)], 1)
    return machine(centres=columns, weights=rows, bias=bias, scale=scale, m=m + more, d=d, k=k)


def machine_values(
    x: Tensor, centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor
) -> tuple[Tensor, Tensor] | None:
    """What `rbf_predict` of `cgtorch.svm.rbf_predict` says, or None as of `machine_structure`."""
    machine = machine_structure(centres, weights, bias, gamma)
    if machine is None:
        return None
    x = x.contiguous()
    values, nearest = x.new_empty(len(x), len(bias)), x.new_empty(len(x))
    share = threads_for(len(x), len(centres))
    function("rbf_values", x.dtype)(machine, x, len(x), values, nearest, share)
    return values, nearest


WORTH_SHARING = 2**19
"""Kernel values that are worth one more thread: about a quarter of a millisecond."""


def threads_for(rows: int, centres: int) -> int:
    """Threads that are worth it for so many kernel values."""
    return max(1, min(threads(), rows * centres // WORTH_SHARING))
