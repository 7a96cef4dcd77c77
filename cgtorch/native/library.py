"""C sources beside this file, compiled once for this very CPU and kept in the user's cache.

A computational graph runs one short step after another, and a tensor operation costs more than
most of them: a thousand operations per step were half of all time. Compiled for the CPU they run
on, as Numba, Triton and torch.compile do it, the same steps take a tenth (docs/decisions.md).

Nothing has to be compiled: where there is no compiler, or `CGTORCH_NATIVE=0` is set, everything
runs in torch, slower and with other roundings.
"""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

SOURCES = Path(__file__).parent
FLAGS = (
    "-O3", "-march=native", "-std=c11", "-fPIC", "-shared", "-pthread",
    "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
SECONDS = 120
"""A compiler that has not ended by then is taken for none."""
REALS = {torch.float32: "float", torch.float64: "double"}

Function = Any
"""A function of a compiled library, with its `argtypes` set."""


def available() -> bool:
    """Whether hot paths run compiled; compiles them the first time, which takes seconds."""
    return _library("rbf", "float") is not None


@cache
def function(source: str, name: str, dtype: torch.dtype, *types: Any) -> Function | None:
    """A function of `source`.c for numbers of a type, or None where nothing can be compiled.

    Args:
        source: which file, without ".c".
        name: of the function.
        dtype: float32 or float64, which is `REAL` in C.
        types: ctypes of its arguments; it returns an int.
    """
    if dtype not in REALS:
        return None
    library = _library(source, REALS[dtype])
    if library is None:
        return None
    found = getattr(library, name)
    found.argtypes, found.restype = types, ctypes.c_int
    return found


def threads() -> int:
    """How many threads compiled code may use: as many as torch."""
    return torch.get_num_threads()


@cache
def _library(source: str, real: str) -> ctypes.CDLL | None:
    """The compiled source, from the cache or made now."""
    compiler = _compiler()
    if compiler is None:
        return None
    try:
        path = _kept(source, real, compiler)
        return ctypes.CDLL(str(path))
    except (OSError, subprocess.SubprocessError):
        return None


def _compiler() -> str | None:
    if os.environ.get("CGTORCH_NATIVE", "1") == "0" or os.name != "posix":
        return None
    return shutil.which(os.environ.get("CC") or "cc")


def _kept(source: str, real: str, compiler: str) -> Path:
    """Where the compiled source lies, named by all that it depends on."""
    command = [compiler, *FLAGS, f"-DREAL={real}", f"-DREAL_IS_{real.upper()}"]
    target = _run([compiler, *FLAGS, "-E", "-dM", "-x", "c", os.devnull])  # version and CPU
    text = b"".join(path.read_bytes() for path in sorted(SOURCES.glob("*.[ch]")))
    about = "\0".join([*command, source, platform.machine(), target])
    name = hashlib.sha256(about.encode() + text).hexdigest()[:32]
    kept = _folder() / f"{source}-{real}-{name}.so"
    if not kept.exists():
        with TemporaryDirectory(dir=kept.parent) as folder:
            made = Path(folder) / kept.name
            _run([*command, str(SOURCES / f"{source}.c"), "-o", str(made), "-lm"])
            made.replace(kept)
    return kept


def _run(command: list[str]) -> str:
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=SECONDS)  # noqa: S603
    return done.stdout


def _folder() -> Path:
    """The user's cache, which nobody else may write to."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "cgtorch"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder
