"""CUDA sources compiled at run time by NVRTC, which comes with torch for GPUs.

It needs neither a GPU nor a toolkit. Without it, nothing runs compiled on a GPU.
"""

import ctypes
import importlib.util
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from cgtorch.native.compiler import SOURCES

FLAGS = ("-std=c++20", "-default-device", "-fmad=false", f"-I{SOURCES}")
"""Each product is rounded before it is added, except where sources say `fma`, as on CPUs."""
NAMES = ("libnvrtc.so", "libnvrtc.so.13", "libnvrtc.so.12")


class CompilationError(RuntimeError):
    """NVRTC refuses a source; the message says why."""


def available() -> bool:
    """Whether NVRTC is installed."""
    return _library() is not None


def version() -> tuple[int, int]:
    """The version of NVRTC; CompilationError without it."""
    major, minor = ctypes.c_int(), ctypes.c_int()
    _check(_found().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor)), "tell its version")
    return major.value, minor.value


def cubin(source: Path, architecture: str, options: Sequence[str]) -> bytes:
    """The machine code of a source for a GPU such as "sm_90"; CompilationError if that fails."""
    nvrtc, program = _found(), ctypes.c_void_p()
    name, text = source.name.encode(), source.read_bytes()
    made = nvrtc.nvrtcCreateProgram(ctypes.byref(program), text, name, 0, None, None)
    _check(made, f"begin with {source.name}")
    try:
        given = [f"-arch={architecture}", *FLAGS, f"-I{source.parent}", *options]
        array = (ctypes.c_char_p * len(given))(*(each.encode() for each in given))
        if nvrtc.nvrtcCompileProgram(program, len(given), array):
            log = _text(program, "ProgramLog").rstrip(b"\0").decode(errors="replace")
            raise CompilationError(f"{source} for {architecture}:\n{log}")
        return _text(program, "CUBIN")
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))


def _text(program: ctypes.c_void_p, what: str) -> bytes:
    nvrtc, size = _found(), ctypes.c_size_t()
    _check(getattr(nvrtc, f"nvrtcGet{what}Size")(program, ctypes.byref(size)), f"give its {what}")
    text = ctypes.create_string_buffer(size.value)
    _check(getattr(nvrtc, f"nvrtcGet{what}")(program, text), f"give its {what}")
    return text.raw


def _check(result: int, what: str) -> None:
    if result:
        raise CompilationError(f"NVRTC cannot {what} (error {result})")


def _found() -> Any:
    library = _library()
    if library is None:
        raise CompilationError("there is no NVRTC; install torch for CUDA, or nvidia-cuda-nvrtc")
    return library


@cache
def _library() -> Any:
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
    yield from NAMES
