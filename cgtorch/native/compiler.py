"""Compiling the C sources below this folder, for this machine or for a wheel.

It needs only Python, as a wheel may be built without torch.
"""

import hashlib
import os
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

SOURCES = Path(__file__).parent
REALS = ("float", "double")
"""The values of `REAL` in the sources: a library is compiled for each."""
FLAGS = (
    "-O3", "-std=c11", "-fPIC", "-pthread", "-fopenmp-simd", "-ffp-contract=off",
    "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
WIDE = "-mprefer-vector-width=512"
"""Without it, compilers use only half of the widest vectors of some CPUs."""
TARGETS = {"AVX512": ("-march=x86-64-v4", WIDE), "AVX2": ("-march=x86-64-v3",)}
"""Targets of the libraries in a wheel, the fastest first, by torch's names of CPU capabilities."""
_DEFINED = {"AVX512": "__AVX512VL__", "AVX2": "__AVX2__"}
"""Macros of compilers that CPUs of these targets have in common."""
SECONDS = 300
"""A compiler that takes longer counts as missing."""


def found_compiler() -> str | None:
    """The C compiler of this machine."""
    return shutil.which(os.environ.get("CC") or "cc") if os.name == "posix" else None


@cache
def sources() -> bytes:
    """All C sources, one after the other."""
    return b"".join(path.read_bytes() for path in sorted(SOURCES.rglob("*.[ch]")))


@cache
def own_target(compiler: str) -> tuple[str, ...]:
    """Compiler options for exactly this CPU; OSError or SubprocessError if there are none."""
    wide = "-march=native", WIDE
    try:
        return wide if "__AVX512F__" in _macros(compiler, wide) else wide[:1]
    except subprocess.SubprocessError:  # it knows no such option
        return wide[:1]


def own_capability(compiler: str) -> str | None:
    """The fastest of `TARGETS` that this CPU can run; None if there is none."""
    macros = _macros(compiler, own_target(compiler))
    return next((name for name in TARGETS if f"#define {_DEFINED[name]} " in macros), None)


def file_name(real: str, compiler: str, target: Sequence[str]) -> str:
    """The name of a library, which depends on all of its inputs."""
    about = [platform.machine(), *_command(compiler, real, target), _macros(compiler, target)]
    key = hashlib.sha256("\0".join(about).encode() + sources()).hexdigest()[:32]
    return f"{real}-{key}.so"


def wheel_file_name(real: str, target: str) -> str:
    """The name of a library in a wheel, for a target of `TARGETS` and these sources."""
    return f"{real}-{target}-{hashlib.sha256(sources()).hexdigest()[:32]}.so"


def c_files() -> list[Path]:
    """The C files, those first that take the compiler longest."""
    slow = "kernel_rollouts", "rollouts", "rbf", "waiting", "models"
    return sorted(SOURCES.rglob("*.c"), key=lambda source: source.stem not in slow)


def compile_libraries(compiler: str, wanted: Mapping[Path, tuple[str, Sequence[str]]]) -> None:
    """Write libraries into one folder, each completely or not at all, on all cores.

    Other processes may do the same at the same time.

    Args:
        compiler: The command.
        wanted: By the path of a library, the type of its numbers and the options for its CPU.

    Raises:
        SubprocessError: The compiler failed.
        OSError: It cannot be called, or the folder cannot be written to.
    """
    (place,) = {path.parent for path in wanted}
    with TemporaryDirectory(dir=place) as folder, ThreadPoolExecutor(os.cpu_count()) as pool:

        def compiled(work: tuple[Path, Path]) -> str:
            source, path = work
            made = str(Path(folder) / f"{path.stem}-{source.parent.name}-{source.stem}.o")
            _run(
                [*_command(compiler, *wanted[path]), f"-I{SOURCES}", "-c", str(source), "-o", made]
            )
            return made

        works = list(product(c_files(), wanted))
        objects = list(pool.map(compiled, works))
        for path in wanted:
            own = [made for made, (_, of) in zip(objects, works, strict=True) if of == path]
            _link(compiler, own, Path(folder) / path.name).replace(path)


def _link(compiler: str, objects: list[str], whole: Path) -> Path:
    _run([compiler, "-shared", "-pthread", *objects, "-o", str(whole), "-lm"])
    whole.chmod(0o755)  # so that nobody else can change it
    with whole.open("rb") as file:
        os.fsync(file.fileno())  # or it may be empty after the machine has failed
    return whole


def _command(compiler: str, real: str, target: Sequence[str]) -> list[str]:
    return [compiler, *FLAGS, *target, f"-DREAL={real}", f"-DREAL_IS_{real.upper()}"]


@cache
def _macros(compiler: str, target: Sequence[str]) -> str:
    """The compiler's version macros, and those of the CPU that it compiles for."""
    return _run([compiler, *FLAGS, *target, "-E", "-dM", "-x", "c", os.devnull])


def _run(command: list[str]) -> str:
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=SECONDS)  # noqa: S603
    return done.stdout
