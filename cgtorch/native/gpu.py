"""NVIDIA GPUs: the CUDA sources below this folder, compiled by NVRTC, launched by the driver.

Machine code is kept in the user's cache, beside the compiled library. NVRTC comes with torch for
GPUs and needs no toolkit. Without it or a driver, a GPU is used through torch.
"""

import ctypes
import hashlib
import importlib.util
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import torch

from cgtorch.native.cache import folder_of_process, is_whole, kept
from cgtorch.native.compiler import SOURCES
from cgtorch.native.library import REALS

FLAGS = ("-std=c++20", "-default-device", "-fmad=false", f"-I{SOURCES}", f"-I{SOURCES / 'cuda'}")
"""Each product is rounded before it is added, except where sources say `fma`, as on CPUs."""


class CompilationError(RuntimeError):
    """NVRTC is missing or refuses a source; the message says why."""


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
        return SOURCES / "cuda" / f"{self.name}.cu"

    def defines(self) -> dict[str, str]:
        """All macros that are defined before the source is compiled."""
        real = REALS[self.dtype].__name__.removeprefix("c_")
        sizes = {name: str(value) for name, value in self.sizes}
        return {"REAL": real, f"REAL_IS_{real.upper()}": "1", **sizes}


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
        """Start a kernel with structures and ctypes numbers, after earlier ones.

        There are so many `blocks`, of so many `threads` and `shared` bytes of memory each.
        CompilationError or RuntimeError if it fails.
        """
        with torch.cuda.device(self.device):
            stream = ctypes.c_void_p(torch.cuda.current_stream(self.device).cuda_stream)
            where = (blocks, 1, 1, threads, 1, 1, shared, stream)
            function = self._function(module, kernel)
            given = function, *where, addresses(arguments), None
            self._call(f"launch {kernel} of {module.name}", "cuLaunchKernel", *given)

    def _function(self, module: Module, kernel: str) -> ctypes.c_void_p:
        if (module, kernel) not in self._functions:
            loaded, image = ctypes.c_void_p(), machine_code(module, self.architecture)
            self._call(f"load {module.name}", "cuModuleLoadData", ctypes.byref(loaded), image)
            for name in module.kernels:
                found = ctypes.c_void_p()
                given = ctypes.byref(found), loaded, name.encode()
                self._call(f"find {name} of {module.name}", "cuModuleGetFunction", *given)
                self._functions[module, name] = found
        return self._functions[module, kernel]

    def _call(self, what: str, name: str, *arguments: Any) -> None:
        if result := getattr(self.driver, name)(*arguments):
            raise RuntimeError(f"the CUDA driver cannot {what} (error {result})")


@cache
def gpu_of(device: torch.device) -> Gpu | None:
    """The GPU of a torch device; None without driver or NVRTC, and for AMD's."""
    if os.environ.get("CGTORCH_NATIVE", "1") == "0" or not torch.cuda.is_available():
        return None
    if torch.version.cuda is None or _nvrtc() is None:
        return None
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None
    torch.zeros(1, device=device)  # the driver works in the context that torch makes
    about = torch.cuda.get_device_properties(device)
    architecture = f"sm_{about.major}{about.minor}"
    return Gpu(device, about.multi_processor_count, architecture, driver)


def launcher_of(device: torch.device) -> Gpu | None:
    """The launcher of kernels on a device; None without one, as on a CPU."""
    return gpu_of(device) if device.type == "cuda" else None


def addresses(arguments: Sequence[Any]) -> Any:
    """An array of the addresses of a kernel's arguments."""
    return (ctypes.c_void_p * len(arguments))(*map(ctypes.addressof, arguments))


def machine_code(module: Module, architecture: str) -> bytes:
    """A module for a GPU such as "sm_90", from the cache or compiled now."""
    options = [f"-D{name}={value}" for name, value in module.defines().items()]
    about = [architecture, *map(str, nvrtc_version()), *FLAGS, *options, sources_digest()]
    key = hashlib.sha256("\0".join(about).encode()).hexdigest()[:32]
    name = f"{module.name}-{architecture}-{key}.cubin"
    path = kept(name) or folder_of_process() / name
    if not is_whole(path):
        made = cubin(module.source, architecture, options)
        with NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(made)
            file.flush()
            os.fsync(file.fileno())
        Path(file.name).replace(path)
    return path.read_bytes()


@cache
def sources_digest() -> str:
    """A hash of all sources of kernels."""
    every = sorted([*SOURCES.rglob("*.h"), *SOURCES.rglob("*.cu")])
    return hashlib.sha256(b"".join(path.read_bytes() for path in every)).hexdigest()


def nvrtc_version() -> tuple[int, int]:
    """The version of NVRTC; CompilationError without it."""
    major, minor = ctypes.c_int(), ctypes.c_int()
    _compile_step("tell its version", "Version", ctypes.byref(major), ctypes.byref(minor))
    return major.value, minor.value


def cubin(source: Path, architecture: str, options: Sequence[str]) -> bytes:
    """The machine code of a source, compiled now; CompilationError if that fails."""
    program, name = ctypes.c_void_p(), source.name.encode()
    made = ctypes.byref(program), source.read_bytes(), name, 0, None, None
    _compile_step(f"begin with {source.name}", "CreateProgram", *made)
    try:
        given = [f"-arch={architecture}", *FLAGS, *options]
        array = (ctypes.c_char_p * len(given))(*(each.encode() for each in given))
        if _nvrtc().nvrtcCompileProgram(program, len(given), array):
            log = _text(program, "ProgramLog").rstrip(b"\0").decode(errors="replace")
            raise CompilationError(f"{source} for {architecture}:\n{log}")
        return _text(program, "CUBIN")
    finally:
        _nvrtc().nvrtcDestroyProgram(ctypes.byref(program))


def _text(program: ctypes.c_void_p, what: str) -> bytes:
    size = ctypes.c_size_t()
    _compile_step(f"measure its {what}", f"Get{what}Size", program, ctypes.byref(size))
    text = ctypes.create_string_buffer(size.value)
    _compile_step(f"give its {what}", f"Get{what}", program, text)
    return text.raw


def _compile_step(what: str, name: str, *arguments: Any) -> None:
    if _nvrtc() is None:
        raise CompilationError("there is no NVRTC; install torch for CUDA, or nvidia-cuda-nvrtc")
    if result := getattr(_nvrtc(), f"nvrtc{name}")(*arguments):
        raise CompilationError(f"NVRTC cannot {what} (error {result})")


@cache
def _nvrtc() -> Any:
    for place in _places():
        try:
            for part in Path(place).parent.glob("libnvrtc-builtins.so*") if "/" in place else ():
                ctypes.CDLL(str(part))  # which some versions look for by name alone
            return ctypes.CDLL(place)
        except OSError:
            continue
    return None


def _places() -> Iterator[str]:
    """Possible places of NVRTC: NVIDIA's packages, torch's, or where the system finds it."""
    for package in ("nvidia", "torch"):
        found = importlib.util.find_spec(package)
        for root in found.submodule_search_locations or () if found else ():
            below = sorted(Path(root).rglob("libnvrtc*.so*"), reverse=True)
            yield from (str(path) for path in below if "builtins" not in path.name)
    yield from ("libnvrtc.so", "libnvrtc.so.13", "libnvrtc.so.12")
