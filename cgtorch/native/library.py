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
    "-O3", "-march=native", "-std=c11", "-fPIC", "-pthread", "-fopenmp-simd",
    "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
LINK = ("-shared", "-pthread")
LONGEST = ("rollout", "rbf", "models")
SECONDS = 120
"""A compiler that has not ended by then is taken for none."""
REALS = {torch.float32: "float", torch.float64: "double"}

Function = Any
"""A function of a compiled library, with its `argtypes` set."""


def available() -> bool:
    """Whether hot paths run compiled; compiles them the first time, which takes seconds."""
    return _library("float") is not None


def to_be_compiled() -> bool:
    """Whether `available` will take seconds: a compiler is there, but not yet what it makes."""
    compiler = _compiler()
    try:
        return compiler is not None and not _kept("float", compiler).exists()
    except (OSError, subprocess.SubprocessError):
        return False


@cache
def function(name: str, dtype: torch.dtype, *types: Any) -> Function | None:
    """A function of the sources for numbers of a type, or None where nothing can be compiled.

    Args:
        name: of the function.
        dtype: float32 or float64, which is `REAL` in C.
        types: ctypes of its arguments; it returns an int.
    """
    if dtype not in REALS:
        return None
    library = _library(REALS[dtype])
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
def _library(real: str) -> ctypes.CDLL | None:
    """The compiled sources, from the cache or made now."""
    compiler = _compiler()
    if compiler is None:
        return None
    try:
        path = _kept(real, compiler)
        if not path.exists():
            _compile(real, compiler, path)
        return ctypes.CDLL(str(path))
    except (OSError, subprocess.SubprocessError):
        return None


def _compiler() -> str | None:
    if os.environ.get("CGTORCH_NATIVE", "1") == "0" or os.name != "posix":
        return None
    return shutil.which(os.environ.get("CC") or "cc")


def _kept(real: str, compiler: str) -> Path:
    """Where the compiled sources lie, named by all that they depend on."""
    text = b"".join(path.read_bytes() for path in sorted(SOURCES.glob("*.[ch]")))
    about = "\0".join([platform.machine(), *_command(real, compiler), _target(compiler)])
    name = hashlib.sha256(about.encode() + text).hexdigest()[:32]
    return _folder() / f"{real}-{name}.so"


def _compile(real: str, compiler: str, path: Path) -> None:
    """Make the file whole or not at all, whoever else is at it, from sources side by side."""
    with TemporaryDirectory(dir=path.parent) as folder, ThreadPoolExecutor() as pool:

        def compiled(source: Path) -> str:
            made = str(Path(folder) / f"{source.stem}.o")
            _run([*_command(real, compiler), "-c", str(source), "-o", made])
            return made

        # Those that take longest go first.
        sources = sorted(SOURCES.glob("*.c"), key=lambda source: source.stem not in LONGEST)
        whole = Path(folder) / path.name
        _run([compiler, *LINK, *pool.map(compiled, sources), "-o", str(whole), "-lm"])
        whole.replace(path)


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
