"""NVRTC makes machine code of all CUDA sources, for GPUs of today and of tomorrow."""

import ctypes
from pathlib import Path

import pytest
import torch
from emulated_gpu import EmulatedGpu
from random_kernel_models import DOMAINS, actions_for, random_kernel_models
from random_models import models_as, random_models
from support import nested_actions

from cgtorch.evolution import compiled as evolution
from cgtorch.native import available, gpu
from cgtorch.native.gpu import Module
from cgtorch.simulation.gpu_engine import GpuEngine
from cgtorch.simulation.rollout import engine_of
from cgtorch.tabletop.actions import paper_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

ELF = b"\x7fELF"
OPTIMISED = "sm_90"
"""Others are compiled without optimisation, which takes four fifths of the time."""


def modules() -> dict[str, Module]:
    """Those that the engine asks for, by name."""
    table = models_as(random_models(0, 3), torch.float32)
    rail = random_kernel_models(0, 3, *DOMAINS["mixed"])
    cases = {
        "tabletop": (nested_actions(0, paper_actions()), table),
        "kernel": (actions_for(rail, 3, nested=False), rail),
    }
    engines = {name: engine_of(*case, EmulatedGpu()) for name, case in cases.items()}
    assert all(isinstance(engine, GpuEngine) for engine in engines.values())
    made = {name: engine.module for name, engine in engines.items() if engine}
    for real, dtype in (("", torch.float32), (" double", torch.float64)):
        made |= {m.name + real: m for m in (evolution.BREEDING(dtype), evolution.SELECTION(dtype))}
    return made


@pytest.mark.parametrize(
    "architecture",
    [
        "sm_80",
        pytest.param("sm_90", marks=pytest.mark.hostile),
        pytest.param("sm_120", marks=pytest.mark.hostile),
    ],
)
@pytest.mark.parametrize("name", modules())
def test_sources_compile(name: str, architecture: str) -> None:
    module = modules()[name]
    options = [f"-D{key}={value}" for key, value in module.defines().items()]
    if architecture != OPTIMISED and gpu.nvrtc_version() >= (13, 0):
        options.append("--Ofast-compile=max")
    image = gpu.cubin(module.source, architecture, options)
    assert image.startswith(ELF)
    assert all(kernel.encode() in image for kernel in module.kernels)


def test_what_does_not_compile_is_told(tmp_path: Path) -> None:
    source = tmp_path / "wrong.cu"
    source.write_text("this is no C\n")
    with pytest.raises(gpu.CompilationError, match=r"wrong\.cu for sm_90"):
        gpu.cubin(source, "sm_90", [])


def test_machine_code_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    module = modules()["selection"]
    first = gpu.machine_code(module, "sm_90")
    (kept,) = (tmp_path / "cgtorch").iterdir()
    assert kept.read_bytes() == first
    monkeypatch.setattr(gpu, "cubin", None)  # nothing is compiled again
    assert gpu.machine_code(module, "sm_90") == first


def test_arguments_are_given_by_their_addresses() -> None:
    numbers = ctypes.c_int64(7), ctypes.c_int(9)
    found = gpu.addresses(numbers)
    assert ctypes.cast(found[0], ctypes.POINTER(ctypes.c_int64)).contents.value == 7
    assert ctypes.cast(found[1], ctypes.POINTER(ctypes.c_int)).contents.value == 9


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_there_is_none() -> None:
    assert gpu.gpu_of(torch.device("cuda", 0)) is None
