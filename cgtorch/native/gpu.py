"""NVIDIA GPUs: the CUDA sources below this folder, compiled by NVRTC, launched by the driver.

Machine code is kept in the user's cache, beside the compiled library. Without NVRTC or a driver, a
GPU is used through torch.
"""

import ctypes
import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, Protocol

import torch

from cgtorch.native import nvrtc
from cgtorch.native.compiler import SOURCES
from cgtorch.native.library import REALS, cache_folder

CUDA = SOURCES / "cuda"


@dataclass(frozen=True)
class Module:
    """The kernels of one source for numbers of one type, with some sizes as constants.

    Attributes:
        name: The name of the source in `native/cuda`.
        dtype: The type of `REAL`.
        kernels: The names of its kernels.
        sizes: Constants by name.
    """

    name: str
    dtype: torch.dtype
    kernels: tuple[str, ...]
    sizes: tuple[tuple[str, int], ...] = ()

    @property
    def source(self) -> Path:
        """The path of the source."""
        return CUDA / f"{self.name}.cu"

    def defines(self) -> dict[str, str]:
        """All macros that are defined before the source is compiled."""
        real = REALS[self.dtype].__name__.removeprefix("c_")
        sizes = {name: str(value) for name, value in self.sizes}
        return {"REAL": real, f"REAL_IS_{real.upper()}": "1", **sizes}


class Launcher(Protocol):
    """An object that runs kernels: a GPU, or an emulation in tests."""

    @property
    def device(self) -> torch.device:
        """The device of tensors."""

    @property
    def multiprocessors(self) -> int:
        """The number of multiprocessors."""

    def launch(
        self, module: Module, kernel: str, blocks: int, threads: int, shared: int, *arguments: Any
    ) -> None:
        """Start a kernel with structures and ctypes numbers, after earlier ones.

        `blocks` and `threads` are numbers of blocks, and of threads per block; `shared` is the
        shared memory of each block in bytes.
        """


@dataclass(frozen=True, eq=False)
class Gpu:
    """A GPU of this machine.

    Attributes:
        device: Its name in torch.
        multiprocessors: The number of multiprocessors.
        architecture: Its name in NVRTC, such as "sm_90".
        driver: The CUDA driver.
    """

    device: torch.device
    multiprocessors: int
    architecture: str
    driver: Any
    _functions: dict[tuple[Module, str], ctypes.c_void_p] = field(default_factory=dict)

    def launch(
        self, module: Module, kernel: str, blocks: int, threads: int, shared: int, *arguments: Any
    ) -> None:
        """See `Launcher.launch`; CompilationError or RuntimeError if it fails."""
        with torch.cuda.device(self.device):
            stream = ctypes.c_void_p(torch.cuda.current_stream(self.device).cuda_stream)
            where = (blocks, 1, 1, threads, 1, 1, shared, stream)
            function = self._function(module, kernel)
            _check(
                self.driver.cuLaunchKernel(function, *where, addresses(arguments), None),
                f"launch {kernel} of {module.name}",
            )

    def _function(self, module: Module, kernel: str) -> ctypes.c_void_p:
        if (module, kernel) not in self._functions:
            loaded = ctypes.c_void_p()
            image = _cubin(module, self.architecture)
            _check(self.driver.cuModuleLoadData(ctypes.byref(loaded), image), f"load {module.name}")
            for name in module.kernels:
                found = ctypes.c_void_p()
                given = ctypes.byref(found), loaded, name.encode()
                _check(self.driver.cuModuleGetFunction(*given), f"find {name} of {module.name}")
                self._functions[module, name] = found
        return self._functions[module, kernel]


@cache
def gpu_of(device: torch.device) -> Gpu | None:
    """The GPU of a torch device; None without driver or NVRTC, and for AMD's."""
    if os.environ.get("CGTORCH_NATIVE", "1") == "0" or not torch.cuda.is_available():
        return None
    if torch.version.cuda is None or not nvrtc.available():
        return None
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None
    torch.zeros(1, device=device)  # the driver works in the context that torch makes
    about = torch.cuda.get_device_properties(device)
    architecture = f"sm_{about.major}{about.minor}"
    return Gpu(device, about.multi_processor_count, architecture, driver)


def launcher_of(device: torch.device) -> Launcher | None:
    """The launcher for a device; None if there is none, as on a CPU."""
    return gpu_of(device) if device.type == "cuda" else None


def addresses(arguments: Sequence[Any]) -> Any:
    """An array of the addresses of a kernel's arguments."""
    places = [ctypes.addressof(each) for each in arguments]
    return (ctypes.c_void_p * len(places))(*places)


def constants_of(sizes: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    """Sizes in the form of a `Module`."""
    return tuple(sorted(sizes.items()))


def _cubin(module: Module, architecture: str) -> bytes:
    """The machine code of a module, from the cache or compiled now."""
    options = [f"-D{name}={value}" for name, value in module.defines().items()]
    about = [architecture, *map(str, nvrtc.version()), *nvrtc.FLAGS, *options, sources_digest()]
    key = hashlib.sha256("\0".join(about).encode()).hexdigest()[:32]
    path = cache_folder() / f"{module.name}-{architecture}-{key}.cubin"
    if not path.exists():
        made = nvrtc.cubin(module.source, architecture, options)
        with NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(made)
        Path(file.name).replace(path)
    return path.read_bytes()


@cache
def sources_digest() -> str:
    """A hash of all sources of kernels."""
    every = sorted([*SOURCES.rglob("*.h"), *SOURCES.rglob("*.cu")])
    return hashlib.sha256(b"".join(path.read_bytes() for path in every)).hexdigest()


def _check(result: int, what: str) -> None:
    if result:
        raise RuntimeError(f"the CUDA driver cannot {what} (error {result})")
