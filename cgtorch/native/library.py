"""C sources below this folder, compiled once for this very CPU and kept in the user's cache.

A computational graph runs one short step after another, which take a tenth of what they would as
tensor operations (docs/decisions/engine.md). Nothing has to be compiled: where there is no
compiler, what was compiled for the wheel is used, if it suits this machine. Else, or with
`CGTORCH_NATIVE=0`, everything runs in torch, slower and with other roundings.
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

from cgtorch.native import compiler
from cgtorch.native.interface import Interface, agree, interface_of

REALS = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
"""What `REAL` is in C for numbers of these types."""
FROM_WHEEL = Path(__file__).parent / "compiled"
"""Where libraries lie that came with a wheel."""
VECTOR = 64
"""Bytes of a vector of numbers, as in real.h."""
WRONG_GRAPHS, NO_PARENT = 2, 3
FAILURES = {"DONE": 0, "NO_MEMORY": 1, "WRONG_GRAPHS": WRONG_GRAPHS, "NO_PARENT": NO_PARENT}
"""What functions return, as in library.h."""


def available() -> bool:
    """Whether hot paths run compiled; compiles them the first time, which takes seconds."""
    return library(torch.float32) is not None


def to_be_compiled() -> bool:
    """Whether `available` will take seconds: a compiler is there, but not yet what it makes."""
    try:
        kept = _kept("float") if _switched_on() else None
        return kept is not None and not kept.exists()
    except (OSError, subprocess.SubprocessError):
        return False


def function(name: str, dtype: torch.dtype) -> Any:
    """A function of the sources for numbers of a type, or None where nothing can be compiled.

    Contiguous tensors and structures are given to it for pointers.
    """
    found = library(dtype)
    return found and found.functions[name]


def structure(name: str, dtype: torch.dtype) -> Any:
    """A class of structures, for numbers of a type, or None where nothing can be compiled."""
    found = library(dtype)
    return found and found.structures[name]


def constants(group: str, dtype: torch.dtype = torch.float32) -> Mapping[str, int]:
    """Constants of the sources by name; none where nothing can be compiled."""
    found = library(dtype)
    return found.constants[group] if found else {}


def suits(*tensors: Tensor) -> bool:
    """Whether C may be asked about tensors (...): on the CPU, of one type, without gradient.

    Where a graph is exported there is nothing in them.
    """
    return tensors[0].is_cpu and alike(*tensors) and not torch.compiler.is_compiling()


def alike(*tensors: Tensor) -> bool:
    """Whether tensors (...) are of one type that C knows, on one device, and without gradient."""
    if torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return False
    dtype, device = tensors[0].dtype, tensors[0].device
    return dtype in REALS and all(t.dtype == dtype and t.device == device for t in tensors)


def threads() -> int:
    """How many threads compiled code may use: as many as torch, or what `use_threads` said."""
    return _threads or torch.get_num_threads()


def use_threads(count: int) -> int:
    """Let compiled code use so many threads, whatever torch uses, or with 0 as many as torch.

    No result depends on it. What was said before is returned.
    """
    global _threads
    before, _threads = _threads, count
    return before


_threads = 0


@cache
def library(dtype: torch.dtype) -> Interface | None:
    """The compiled sources for a type, cached or made now; ImportError if Python disagrees."""
    if not _switched_on() or dtype not in REALS:
        return None
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
    """The library that is compiled here, or else one from the wheel, or None."""
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
    """Where the compiled sources lie, or will; None without a compiler."""
    name = compiler.found_compiler()
    if name is None:
        return None
    return cache_folder() / compiler.file_name(real, name, compiler.own_target(name))


def cache_folder() -> Path:
    """Where what is compiled is kept, for this user alone; OSError if it cannot be made."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "cgtorch"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def _from_wheel(real: str) -> ctypes.CDLL | None:
    """The fastest library of the wheel that this CPU can run, of these very sources."""
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
