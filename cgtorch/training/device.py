"""The device on which populations are evaluated: the one asked for, or the fastest."""

import os

import torch

from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import SettingsError
from cgtorch.native.gpu import launcher_of
from cgtorch.report import ProgressDisplay
from cgtorch.runs.stored_run import StoredRun
from cgtorch.simulation.compiled import WITH_MEMORY

WORTH_A_GPU = 4000
"""Population size from which a GPU is faster than the CPU (docs/decisions/engine.md)."""


def device_for(run: StoredRun, name: str, display: ProgressDisplay) -> torch.device:
    """The device that is asked for; SettingsError if it cannot be used."""
    return fastest_device(run, display) if name == "auto" else device_named(name)


def device_named(name: str) -> torch.device:
    """The device with that name; SettingsError if it cannot be used."""
    # Each rank of a machine has its own.
    number = f":{os.environ['LOCAL_RANK']}" if name == "cuda" and "LOCAL_RANK" in os.environ else ""
    try:
        device = torch.device(name + number)
        torch.zeros(1, device=device).item()  # which the meta device refuses
    except (RuntimeError, AssertionError) as e:
        raise SettingsError(f"device {name!r} cannot be used; give auto, cpu or cuda") from e
    return device


def fastest_device(run: StoredRun, display: ProgressDisplay) -> torch.device:
    """A GPU, if its kernels support the run and the population is large; else the CPU.

    If there is a GPU, the choice is shown. Actions without a kernel run as torch operations on a
    GPU, which are slower than the CPU.
    """
    if not torch.cuda.is_available():
        return torch.device("cpu")
    gpu, population = torch.device("cuda"), run.settings.population
    actions = run.actions.actions
    known = all(a.native_kind and a.native_kind not in WITH_MEMORY for a in actions)
    known &= ranks.count() == 1
    name, why, other = "cpu", f"is as fast as a GPU for a population of {population}", "cuda"
    if not known or launcher_of(gpu) is None:
        why = "is faster, as a GPU has no kernels for this run"
    elif population >= WORTH_A_GPU:
        name, why, other = "cuda", f"is faster for a population of {population}", "cpu"
    display.say(f"device: {name}, which {why}; --device {other} selects the other one")
    return torch.device(name)
