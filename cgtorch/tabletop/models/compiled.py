"""The tabletop's Γ and C as compiled code knows them, and what it says of many rows.

The same numbers as torch's but for the last digits; a row's do not depend on the rows beside it.
"""

import torch
from torch import Tensor

from cgtorch.native import function
from cgtorch.native.structures import MOST_PERCEPT, POINTER, WHOLE, structures
from cgtorch.svm.compiled import LOG2E, Compiled, machine_structure, threads_for


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
        novelty.data_ptr(), threads_for(n, gamma.structure.machine.m),
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
        classifier.address, size, percept.data_ptr(), n, chance.data_ptr(), threads_for(n, centres)
    )  # fmt: skip
    return chance
