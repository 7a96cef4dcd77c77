"""C sources below this folder, compiled once for this very CPU and kept in the user's cache.

A computational graph runs one short step after another, which take a tenth of what they would as
tensor operations (docs/decisions.md). Nothing has to be compiled: where there is no compiler, or
`CGTORCH_NATIVE=0` is set, everything runs in torch, slower and with other roundings.
"""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import Tensor

from cgtorch.native.interface import Interface, agree, interface_of

SOURCES = Path(__file__).parent
FLAGS = (
    "-O3", "-march=native", "-std=c11", "-fPIC", "-pthread", "-fopenmp-simd",
    "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
LINK = ("-shared", "-pthread")
LONGEST = ("rollout", "rbf", "models")
SECONDS = 120
"""A compiler that has not ended by then is taken for none."""
REALS = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
"""What `REAL` is in C for numbers of these types."""
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
    compiler = _compiler()
    try:
        return compiler is not None and not _kept("float", compiler).exists()
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
    """Whether C may be asked about tensors (...): on the CPU, of one type, without gradient."""
    if torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return False
    dtype = tensors[0].dtype
    return dtype in REALS and all(t.dtype == dtype and t.device.type == "cpu" for t in tensors)


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
    compiler = _compiler()
    if compiler is None or dtype not in REALS:
        return None
    real = REALS[dtype].__name__.removeprefix("c_")
    try:
        path = _kept(real, compiler)
        if not path.exists():
            _compile(real, compiler, path)
        loaded = ctypes.CDLL(str(path))
    except (OSError, subprocess.SubprocessError):
        return None
    found = interface_of(loaded, _sources().decode(), REALS[dtype])
    agree(found.constants["failures"], FAILURES)
    agree(found.constants["vector"], {"BYTES": VECTOR})
    return found


def _compiler() -> str | None:
    if os.environ.get("CGTORCH_NATIVE", "1") == "0" or os.name != "posix":
        return None
    return shutil.which(os.environ.get("CC") or "cc")


def _kept(real: str, compiler: str) -> Path:
    """Where the compiled sources lie, named by all that they depend on."""
    about = "\0".join([platform.machine(), *_command(real, compiler), _target(compiler)])
    name = hashlib.sha256(about.encode() + _sources()).hexdigest()[:32]
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "cgtorch"  # which nobody else may write to
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder / f"{real}-{name}.so"


@cache
def _sources() -> bytes:
    """All C sources, one after the other."""
    return b"".join(path.read_bytes() for path in sorted(SOURCES.rglob("*.[ch]")))


def _compile(real: str, compiler: str, path: Path) -> None:
    """Make the file whole or not at all, whoever else is at it, from sources side by side."""
    with TemporaryDirectory(dir=path.parent) as folder, ThreadPoolExecutor() as pool:

        def compiled(source: Path) -> str:
            made = str(Path(folder) / f"{source.stem}.o")
            _run([*_command(real, compiler), f"-I{SOURCES}", "-c", str(source), "-o", made])
            return made

        # Those that take longest go first.
        sources = sorted(SOURCES.rglob("*.c"), key=lambda source: source.stem not in LONGEST)
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
