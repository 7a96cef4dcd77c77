"""Algorithm 3 on a GPU: the C sources of the compiled engine as kernels, with the same bits.

Sizes that are the same in all launches are constants of the kernels (native/cuda/rollouts.h).
"""

import ctypes
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.native import constants, structure
from cgtorch.native.gpu import Gpu, Module
from cgtorch.simulation.compiled import CompiledActions, CompiledEngine, program_of, task_of
from cgtorch.simulation.model import CompiledModels
from cgtorch.simulation.program import check_numbers

KERNELS = ("rollouts", "evaluations", "check", "fitness")
THREADS, BLOCKS = 128, 4
"""Threads per block, and blocks for which a multiprocessor has registers."""
WARP = 32
FEWEST = 4
"""The fewest lanes of a warp. With few lanes, more warps hide each other's latency."""
SHARED = 48 * 1024
"""Bytes of shared memory of a block without a special request."""


@dataclass(frozen=True)
class GpuEngine(CompiledEngine):
    """Actions and models in the form of kernels; tables and tensors are on the GPU.

    Attributes:
        gpu: Runs the kernels.
        module: The kernels.
        shared: Bytes of shared memory for the machines of Γ and C, 0 if they do not fit.
    """

    gpu: Gpu
    module: Module
    shared: int

    def _ran(
        self,
        name: str,
        graphs: Graphs,
        scenarios: Tensor,
        max_transitions: int,
        max_steps: int,
        **rest: Any,
    ) -> tuple[int, int, int] | None:
        program = program_of(graphs, self.known, (max_transitions, max_steps))
        if program is None or self.known.resumable_alone(graphs):
            return None
        (p, b), device, dtype = (len(graphs), len(scenarios)), self.gpu.device, self.known.dtype
        numbers = constants("counts", dtype)
        counts = torch.zeros(numbers["COUNTS"], dtype=torch.long, device=device)
        lost, bad = torch.empty(2, p, dtype=torch.int32, device=device).unbind()
        limits = {"max_transitions": max_transitions, "max_steps": max_steps}
        task = task_of(self, graphs, scenarios, program=None, **limits, **rest)
        models, kept = self.models.structure, rest.get("keep", 0)
        evaluates = name == "evaluations"

        def launch_of(begin: int, end: int, most: int) -> Any:
            return structure("Launch", dtype)(
                lost=lost, bad=bad, counts=counts, begin=begin, end=end, most=most
            )

        about = ctypes.c_int64(p), ctypes.c_int(evaluates)
        self._launch("check", p * WARP, 0, program, launch_of(0, 0, 0), *about)
        for begin, end in ((0, kept), (kept, b)):
            if begin < end and p:
                most, threads = self._spread(p * (end - begin))
                launch = launch_of(begin, end, most)
                parts = program, self.environment, models, launch, ctypes.c_int(self.shared > 0)
                self._launch(name, threads, self.shared, task, *parts)
        if evaluates:
            self._launch("fitness", p, 0, task, launch_of(0, b, 0))
        found = dict(zip(numbers, counts.tolist(), strict=False))
        if found["WRONG"]:
            check_numbers(graphs, len(self.actions))
        return found["COUNTED"], found["EXECUTED"], found["NUM_NOT_FINITE"]

    def _spread(self, lanes: int) -> tuple[int, int]:
        """The largest number of lanes per warp, and the number of threads."""
        room = self.gpu.multiprocessors * BLOCKS * THREADS
        most = min(WARP, max(FEWEST, -(-lanes * WARP // room)))
        return most, min(room, -(-lanes // most) * WARP)

    def _launch(self, kernel: str, threads: int, shared: int, *arguments: Any) -> None:
        if threads:
            blocks = -(-threads // THREADS)
            self.gpu.launch(self.module, kernel, blocks, THREADS, shared, *arguments)


def gpu_engine(
    actions: ActionSet,
    known: CompiledActions,
    models: CompiledModels,
    environment: Any,
    percept_size: int,
    gpu: Gpu,
) -> GpuEngine:
    """The engine of actions in models whose tensors are on a GPU."""
    found, networks = models.structure, {(a.inputs, a.hidden) for a in known.networks()}
    machines, known = (found.gamma, found.classifier), known.to(gpu.device)
    # The tabletop's models have more than a machine each.
    gamma, classifier = (getattr(each, "machine", each) for each in machines)
    program, size = known.program, torch.finfo(models.dtype).bits // 8
    sizes = {
        "MOST_PERCEPT": percept_size,
        "MOST_MESSAGE": max(2, known.table.message_size),  # a branch says two numbers
        "MOST_HIDDEN": max([1, *(hidden for _, hidden in networks)]),
        "MOST_DEPTH": max(1, program["depth"]),
        "MOST_FEATURES": max(gamma.d, classifier.d) + 1,  # C may make one more than it uses
        "MOST_OUTPUTS": max(gamma.k, classifier.k),
        "CONTROLS": environment.controls,
        "DEPTH": program["depth"],
        "ROWS": program["rows"],
        "PRIMITIVES": program["count"],
        "OUTCOMES": program["outcomes"],
        "ACTION_OUTCOMES": program["most"],
        "WIDTH_OF_SKILLS": program["width"],
        "GAMMA_CENTRES": gamma.m,
        "GAMMA_FEATURES": gamma.d,
        "GAMMA_OUTPUTS": gamma.k,
        "CLASSIFIER_CENTRES": classifier.m,
        "CLASSIFIER_FEATURES": classifier.d,
        "THREADS": THREADS,
        "BLOCKS": BLOCKS,
    }
    if len(networks) == 1:
        ((sizes["INPUTS"], sizes["HIDDEN"]),) = networks
    module = Module(models.name, models.dtype, KERNELS, tuple(sorted(sizes.items())))
    shared = size * sum(machine.m * (machine.d + machine.k) for machine in (gamma, classifier))
    fits = shared if shared <= SHARED else 0
    return GpuEngine(actions, known, models, environment, percept_size, gpu, module, fits)
