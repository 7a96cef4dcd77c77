"""The machines of Γ and C as compiled code knows them."""

from typing import Any

from torch import Tensor

from cgtorch.native import alike, constants
from cgtorch.svm.compiled import machine_structure
from cgtorch.svm.machine import KernelMachine


def compiled_machine(machine: KernelMachine, percept: Tensor, *more: Tensor) -> Any:
    """A machine of one output, or None where C cannot be asked about percepts (n, D) and more."""
    if not alike(percept, *machine._machine, *more) or not machine.fitted:
        return None
    made = machine_structure(*machine._machine)
    if made is None or made.k != 1:
        return None
    most = constants("engine_limits", percept.dtype)["MOST_PERCEPT"]
    return made if percept.shape[-1] <= most else None
