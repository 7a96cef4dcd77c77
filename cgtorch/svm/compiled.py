"""RBF machines as compiled code knows them, and what it says of many rows.

The same numbers as torch's but for the last digits; a row's do not depend on the rows beside it.
"""

import ctypes
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.native import function, threads
from cgtorch.native.structures import (
    MOST_FEATURES,
    MOST_OUTPUTS,
    POINTER,
    WHOLE,
    WIDTH,
    structures,
)

LOG2E = math.log2(math.e)


@dataclass(frozen=True)
class Compiled:
    """A structure and the tensors that it points into."""

    structure: Any
    kept: tuple[Tensor, ...]

    @property
    def address(self) -> int:
        """Where the structure lies."""
        return ctypes.addressof(self.structure)


def machine_structure(
    centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor
) -> Compiled | None:
    """An RBF machine of centres (m, d), weights (m, k), bias (k,) and gamma (), or None.

    None where compiled code has no room for it.
    """
    (m, d), k = centres.shape, len(bias)
    if not 0 < d <= MOST_FEATURES or not 0 < k <= MOST_OUTPUTS or m == 0:
        return None
    scale, more = math.sqrt(float(gamma) * LOG2E), -m % WIDTH[centres.dtype]
    scaled = (centres * scale).T
    # Filled up with a centre that is there already, so that no other is nearest; its weight is 0.
    columns = torch.cat([scaled, scaled[:, :1].expand(d, more)], 1).contiguous()
    rows = torch.cat([weights.T, weights.new_zeros(k, more)], 1).contiguous()
    bias = bias.contiguous()
    pointers = columns.data_ptr(), rows.data_ptr(), bias.data_ptr()
    made = structures(centres.dtype).Machine(*pointers, scale, m + more, d, k)
    return Compiled(made, (columns, rows, bias))


def machine_values(
    x: Tensor, centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor
) -> tuple[Tensor, Tensor] | None:
    """Values (n, k) of rows x (n, d), and γ |x - c|² log2(e) (n,) of the nearest centre, or None.

    None where nothing is compiled or there is no room for the machine.
    """
    call = function(
        "rbf_values", x.dtype, POINTER, POINTER, WHOLE, POINTER, POINTER, WHOLE
    )  # fmt: skip
    machine = machine_structure(centres, weights, bias, gamma) if call else None
    if call is None or machine is None:
        return None
    x = x.contiguous()
    values, nearest = x.new_empty(len(x), len(bias)), x.new_empty(len(x))
    call(
        machine.address, x.data_ptr(), len(x), values.data_ptr(), nearest.data_ptr(),
        threads_for(len(x), len(centres)),
    )  # fmt: skip
    return values, nearest


WORTH_SHARING = 2**19
"""Kernel values that are worth one more thread: about a quarter of a millisecond."""


def threads_for(rows: int, centres: int) -> int:
    """Threads that are worth it for so many kernel values."""
    return max(1, min(threads(), rows * centres // WORTH_SHARING))
