"""A GPU that is none: CUDA sources compiled for the CPU, which runs their threads in turns.

Warps exchange numbers as on a GPU (`emulated_gpu.h`). So all is tried where there is no GPU but for
the machine code, which NVRTC makes, and for who comes first.
"""

import ctypes
import hashlib
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import torch
from pretended_gpu import GPU

from cgtorch.native.compiler import SOURCES
from cgtorch.native.gpu import Gpu, Module, addresses, gpu_of, sources_digest

HERE = Path(__file__).parent
FLAGS = (
    "-O1", "-std=c++20", "-fPIC", "-shared", "-march=native", "-ffp-contract=off",
    "-fno-tree-slp-vectorize", "-fno-math-errno", "-Wno-psabi", "-Wno-unknown-pragmas",
    "-fpermissive", "-w", "-Dalways_inline=unused",
)  # fmt: skip
"""Without inlining all that a GPU inlines, kernels are compiled in a quarter of the time."""
FOLDER = Path(tempfile.gettempdir()) / "cgtorch-emulated-gpu"


class EmulatedGpu:
    """As `cgtorch.native.gpu.Gpu`, for tensors on the CPU."""

    device = torch.device("cpu")
    multiprocessors = 2

    def launch(
        self, module: Module, kernel: str, blocks: int, threads: int, shared: int, *arguments: Any
    ) -> None:
        """Run all threads of a kernel to their ends."""
        function = getattr(compiled(module), f"launch_{kernel}")
        function(ctypes.c_uint(blocks), ctypes.c_uint(threads), addresses(arguments))


class OnGpu(EmulatedGpu):
    """It stands in for the GPU that pretended tensors say they are on."""

    device = GPU


def launchers() -> list[Gpu]:
    """What stands in for a GPU, and this machine's own if it has one."""
    own = gpu_of(GPU) if torch.cuda.is_available() else None
    return [EmulatedGpu(), *([own] if own else [])]


@cache
def compiled(module: Module) -> ctypes.CDLL:
    """A library of a module's kernels, kept for all tests, made whole or not at all."""
    text = '#include "emulated_gpu.h"\n'
    text += "".join(f"#define {name} {value}\n" for name, value in module.defines().items())
    text += f'#include "{module.source.relative_to(SOURCES)}"\n'
    text += "real shared[1 << 16];\n"
    for name in module.kernels:
        text += (
            f'extern "C" void launch_{name}(unsigned blocks, unsigned count, void **given) '
            f"{{ launch({name}, blocks, count, given); }}\n"
        )
    FOLDER.mkdir(exist_ok=True)
    about = [text, sources_digest(), (HERE / "emulated_gpu.h").read_text(), *FLAGS]
    key = hashlib.sha256("\0".join(about).encode())
    path = FOLDER / f"{key.hexdigest()[:32]}.so"
    if not path.exists():
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:
            source, made = Path(folder) / "kernels.cpp", Path(folder) / "kernels.so"
            source.write_text(text)
            command = ["c++", *FLAGS, f"-I{HERE}", f"-I{SOURCES}", str(source), "-o", str(made)]
            subprocess.run(command, check=True)
            made.replace(path)
    return ctypes.CDLL(str(path))
