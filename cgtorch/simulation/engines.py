"""The choice of an engine: compiled on the CPU or a GPU, depending on the device of the models."""

from cgtorch.graphs import ActionSet
from cgtorch.ground.environment import Environment
from cgtorch.native.gpu import Gpu, launcher_of
from cgtorch.simulation.compiled import CompiledEngine, compiled_models
from cgtorch.simulation.compiled_actions import NETWORKS, ROUTINES, WITH_MEMORY, compiled_actions
from cgtorch.simulation.gpu_engine import GpuEngine, gpu_engine
from cgtorch.simulation.model import ModelEnvironment


def engine_of(
    actions: ActionSet, environment: Environment, gpu: Gpu | None = None
) -> CompiledEngine | GpuEngine | None:
    """The engine of actions in models, or None if the environment is not compiled.

    For models on a GPU it is an engine on that GPU, or on `gpu` if given.
    """
    if type(environment) is not ModelEnvironment or environment.compiled is None:
        return None
    device = environment.percepts.device
    gpu = gpu or launcher_of(device)
    found = compiled_models(environment) if gpu or device.type == "cpu" else None
    if found is None:
        return None
    models, own = found
    size, kinds = environment.percept_size, (*ROUTINES, *NETWORKS, *WITH_MEMORY, *models.networks)
    known = compiled_actions(actions, size, models.dtype, kinds)
    if known is None or known.table.message_size < environment.control_size:
        return None
    if gpu:
        return gpu_engine(actions, known, models, own, size, gpu)
    return CompiledEngine(actions, known, models, own, size)
