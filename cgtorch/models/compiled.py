"""Γ, C and RBF machines as compiled code knows them, and what it says of many rows.

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
    MOST_PERCEPT,
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
    """An RBF machine, or None where compiled code has no room for it.

    Args:
        centres: (m, d).
        weights: (m, k).
        bias: (k,).
        gamma: ().
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
        _threads(len(x), len(centres)),
    )  # fmt: skip
    return values, nearest


def gamma_structure(
    machine: tuple[Tensor, Tensor, Tensor, Tensor], numbers: dict[str, Tensor]
) -> Compiled | None:
    """Γ, given its machine and its other buffers by name, or None where there is no room."""
    made = machine_structure(*machine)
    if made is None or made.structure.d != 4 or made.structure.k != 1:
        return None
    gamma = structures(machine[0].dtype).Gamma(
        machine=made.structure, per_distance=1 / (float(machine[3]) * LOG2E)
    )
    for name, value in numbers.items():
        field = getattr(gamma, name)
        if value.dim():
            field[:] = value.tolist()
        else:
            setattr(gamma, name, float(value))
    return Compiled(gamma, made.kept)


def transitions(gamma: Compiled, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor] | None:
    """Next percepts (n, D) and novelties (n,) of percepts (n, D) and motions (n, 3), or None."""
    call = function(
        "transitions", percept.dtype,
        POINTER, WHOLE, POINTER, POINTER, WHOLE, POINTER, POINTER, WHOLE,
    )  # fmt: skip
    n, size = percept.shape
    if call is None or size > MOST_PERCEPT:
        return None
    percept, motion = percept.contiguous(), motion.contiguous()
    after, novelty = torch.empty_like(percept), percept.new_empty(n)
    call(
        gamma.address, size, percept.data_ptr(), motion.data_ptr(), n, after.data_ptr(),
        novelty.data_ptr(), _threads(n, gamma.structure.machine.m),
    )  # fmt: skip
    return after, novelty


def classifier_structure(
    machine: tuple[Tensor, Tensor, Tensor, Tensor], mean: Tensor, scale: Tensor, platt: Tensor
) -> Compiled | None:
    """C, given its machine and its other buffers, or None where there is no room."""
    made = machine_structure(*machine)
    if made is None or made.structure.k != 1 or not bool(torch.isfinite(platt).all()):
        return None
    mean, scale = mean.contiguous(), scale.contiguous()
    classifier = structures(mean.dtype).Classifier(
        made.structure, mean.data_ptr(), scale.data_ptr(), *platt.tolist()
    )
    return Compiled(classifier, (*made.kept, mean, scale))


def successes(classifier: Compiled, percept: Tensor) -> Tensor | None:
    """Probabilities (n,) of success at percepts (n, D), or None."""
    call = function("successes", percept.dtype, POINTER, WHOLE, POINTER, WHOLE, POINTER, WHOLE)
    n, size = percept.shape
    if call is None or size > MOST_PERCEPT:
        return None
    percept = percept.contiguous()
    chance = percept.new_empty(n)
    centres = classifier.structure.machine.m
    call(
        classifier.address, size, percept.data_ptr(), n, chance.data_ptr(), _threads(n, centres)
    )  # fmt: skip
    return chance


WORTH_SHARING = 2**19
"""Kernel values that are worth one more thread: about a quarter of a millisecond."""


def _threads(rows: int, centres: int) -> int:
    return max(1, min(threads(), rows * centres // WORTH_SHARING))
