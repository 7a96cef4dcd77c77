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
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

SOURCES = Path(__file__).parent
FLAGS = (
    "-O3", "-march=native", "-std=c11", "-fPIC", "-shared", "-pthread",
    "-fopenmp-simd", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
SECONDS = 120
"""A compiler that has not ended by then is taken for none."""
REALS = {torch.float32: "float", torch.float64: "double"}

Function = Any
"""A function of a compiled library, with its `argtypes` set."""


def available() -> bool:
    """Whether hot paths run compiled; compiles one of them the first time, which takes seconds."""
    return _library("rbf", "float") is not None


def to_be_compiled() -> bool:
    """Whether `prepare` has work to do: a compiler is there, but not yet what it makes."""
    compiler = _compiler()
    try:
        return compiler is not None and any(
            not _kept(path.stem, "float", compiler).exists() for path in SOURCES.glob("*.c")
        )
    except (OSError, subprocess.SubprocessError):
        return False


def prepare() -> None:
    """Compile all sources, side by side, so that nobody waits for it later."""
    with ThreadPoolExecutor() as pool:
        list(pool.map(lambda path: _library(path.stem, "float"), SOURCES.glob("*.c")))


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
def _library(source: str, real: str) -> ctypes.CDLL | None:
    """The compiled source, from the cache or made now."""
    compiler = _compiler()
    if compiler is None:
        return None
    try:
        path = _kept(source, real, compiler)
        if not path.exists():
            _compile(source, real, compiler, path)
        return ctypes.CDLL(str(path))
    except (OSError, subprocess.SubprocessError):
        return None


def _compiler() -> str | None:
    if os.environ.get("CGTORCH_NATIVE", "1") == "0" or os.name != "posix":
        return None
    return shutil.which(os.environ.get("CC") or "cc")


def _kept(source: str, real: str, compiler: str) -> Path:
    """Where the compiled source lies, named by all that it depends on."""
    text = b"".join(path.read_bytes() for path in sorted(SOURCES.glob("*.[ch]")))
    about = "\0".join([source, platform.machine(), *_command(real, compiler), _target(compiler)])
    name = hashlib.sha256(about.encode() + text).hexdigest()[:32]
    return _folder() / f"{source}-{real}-{name}.so"


def _compile(source: str, real: str, compiler: str, path: Path) -> None:
    """Make the file whole or not at all, whoever else is at it."""
    with TemporaryDirectory(dir=path.parent) as folder:
        made = Path(folder) / path.name
        _run([*_command(real, compiler), str(SOURCES / f"{source}.c"), "-o", str(made), "-lm"])
        made.replace(path)


def _command(real: str, compiler: str) -> list[str]:
    return [compiler, *FLAGS, f"-DREAL={real}", f"-DREAL_IS_{real.upper()}"]


@cache
def _target(compiler: str) -> str:
    """What the compiler says of its version and of this CPU."""
    return _run([compiler, *FLAGS, "-E", "-dM", "-x", "c", os.devnull])


def _run(command: list[str]) -> str:
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=SECONDS)  # noqa: S603
    return done.stdout


def _folder() -> Path:
    """The user's cache, which nobody else may write to."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "cgtorch"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder
