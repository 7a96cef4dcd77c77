"""The C sources below this folder, compiled once for this CPU and kept in the user's cache.

A computational graph runs one short step after another, and in C these take a tenth of the time of
tensor operations (docs/decisions/engine.md). Compilation is optional. Without a compiler, the
library of the wheel is used if it suits this machine. Without either, or with `CGTORCH_NATIVE=0`,
everything but the kinematics of arms runs in torch, slower and with other rounding.
"""

import ctypes
import os
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import CompilerError
from cgtorch.native import compiler
from cgtorch.native.interface import Interface, agree, interface_of

REALS = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
"""The type of `REAL` in C for numbers of these types."""
FROM_WHEEL = Path(__file__).parent / "compiled"
"""The folder of libraries that came with a wheel."""
VECTOR = 64
"""The size of a vector of numbers in bytes, as in real.h."""
WRONG_GRAPHS = 2
FAILURES = {"DONE": 0, "NO_MEMORY": 1, "WRONG_GRAPHS": WRONG_GRAPHS}
"""The return values of functions, as in library.h."""


def available() -> bool:
    """Whether hot paths run compiled; the first call compiles them, which takes seconds."""
    return library(torch.float32) is not None


def to_be_compiled() -> bool:
    """Whether `available` will take seconds: there is a compiler, but no library yet."""
    try:
        kept = _kept("float") if _switched_on() else None
        return kept is not None and not kept.exists()
    except (OSError, subprocess.SubprocessError):
        return False


def function(name: str, dtype: torch.dtype) -> Any:
    """A function of the sources for numbers of a type, or None if nothing can be compiled.

    Contiguous tensors and structures can be passed for pointers.
    """
    found = library(dtype)
    return found and found.functions[name]


def structure(name: str, dtype: torch.dtype) -> Any:
    """A function that makes a structure for numbers of a type, or None without compiled code."""
    found = library(dtype)
    return found and found.structures[name]


def constants(group: str, dtype: torch.dtype = torch.float32) -> Mapping[str, int]:
    """Constants of the sources by name; empty if nothing can be compiled."""
    found = library(dtype)
    return found.constants[group] if found else {}


def suits(*tensors: Tensor) -> bool:
    """Whether C can process tensors (...): on the CPU, of one type, without gradient.

    It is False while a graph is exported, as there are no numbers then.
    """
    return tensors[0].is_cpu and alike(*tensors) and not torch.compiler.is_compiling()


def alike(*tensors: Tensor) -> bool:
    """Whether tensors (...) have one type that C supports, one device, and no gradient."""
    if torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return False
    dtype, device = tensors[0].dtype, tensors[0].device
    return dtype in REALS and all(t.dtype == dtype and t.device == device for t in tensors)


def threads() -> int:
    """The number of threads of compiled code: torch's, or the number set by `use_threads`."""
    return _threads or torch.get_num_threads()


def use_threads(count: int) -> int:
    """Set the number of threads of compiled code; with 0 it is torch's number.

    No result depends on it. The previous setting is returned.
    """
    global _threads
    before, _threads = _threads, count
    return before


_threads = 0


def library(dtype: torch.dtype) -> Interface | None:
    """The compiled sources for a type, or None without any or if they are switched off."""
    return built(dtype) if _switched_on() and dtype in REALS else None


def required(dtype: torch.dtype) -> Interface:
    """The compiled sources for a type, for what has no other way, even with `CGTORCH_NATIVE=0`.

    CompilerError without a C compiler and a wheel.
    """
    found = built(dtype)
    if found is None:
        raise CompilerError(
            "the kinematics of arms needs compiled code, and there is none for this machine: "
            "install a C compiler such as gcc (or name yours by CC), or install cgtorch from a "
            "wheel for this machine"
        )
    return found


@cache
def built(dtype: torch.dtype) -> Interface | None:
    """The compiled sources for a type of `REALS`, from the cache or compiled now.

    ImportError if Python and the library disagree.
    """
    loaded = _loaded(REALS[dtype].__name__.removeprefix("c_"))
    if loaded is None:
        return None
    found = interface_of(loaded, compiler.sources().decode(), REALS[dtype])
    agree(found.constants["failures"], FAILURES)
    agree(found.constants["vector"], {"BYTES": VECTOR})
    return found


def _switched_on() -> bool:
    return os.environ.get("CGTORCH_NATIVE", "1") != "0"


def _loaded(real: str) -> ctypes.CDLL | None:
    """The library compiled on this machine, or else one from the wheel, or None."""
    try:
        if path := _kept(real):
            if not path.exists():
                name = compiler.found_compiler() or ""
                compiler.compile_library(real, name, compiler.own_target(name), path)
            return ctypes.CDLL(str(path))
    except (OSError, subprocess.SubprocessError):
        pass
    return _from_wheel(real)


def _kept(real: str) -> Path | None:
    """The path of the compiled sources, whether they exist or not; None without a compiler."""
    name = compiler.found_compiler()
    if name is None:
        return None
    return cache_folder() / compiler.file_name(real, name, compiler.own_target(name))


def cache_folder() -> Path:
    """The folder of compiled libraries, for this user alone; OSError if it cannot be made."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "cgtorch"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def _from_wheel(real: str) -> ctypes.CDLL | None:
    """The fastest library of the wheel that this CPU can run, if it is of the same sources."""
    known, able = list(compiler.TARGETS), torch.backends.cpu.get_cpu_capability()
    if platform.machine() not in ("x86_64", "AMD64") or able not in known:
        return None
    for target in known[known.index(able) :]:
        path = FROM_WHEEL / compiler.wheel_file_name(real, target)
        if path.exists():
            try:
                return ctypes.CDLL(str(path))
            except OSError:
                continue
    return None
