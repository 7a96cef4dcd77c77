"""The machines of Γ and C in the form of compiled code."""

from typing import Any

from torch import Tensor

from cgtorch.native import alike, constants
from cgtorch.svm.compiled import machine_structure
from cgtorch.svm.machine import KernelMachine


def compiled_machine(machine: KernelMachine, percept: Tensor, *more: Tensor) -> Any:
    """A machine with one output, or None if C does not support percepts (n, D) and the rest."""
    if not alike(percept, *machine._machine, *more) or not machine.fitted:
        return None
    made = machine_structure(*machine._machine)
    if made is None or made.k != 1:
        return None
    most = constants("engine_limits", percept.dtype)["MOST_PERCEPT"]
    return made if percept.shape[-1] <= most else None
