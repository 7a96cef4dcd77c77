"""The C sources below this folder, compiled once for this CPU and kept in the user's cache.

A computational graph runs one short step after another, and in C these take a tenth of the time of
tensor operations (docs/decisions/engine.md). Without a compiler, the library of the wheel is used
if it suits this machine. Without either, or with `CGTORCH_NATIVE=0`, everything but the kinematics
of arms runs in torch, slower and with other rounding.

Functions and structures are parsed from the sources. Constants and the sizes of structures come
from the compiled library itself (library.h), which is refused if the sizes differ.
"""

import ctypes
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Timer
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import CompilerError
from cgtorch.native import compiler
from cgtorch.native.cache import folder_of_process, is_whole, kept

REALS = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
"""The type of `REAL` in C for numbers of these types."""
FROM_WHEEL = Path(__file__).parent / "compiled"
"""The folder of libraries that came with a wheel."""
VECTOR = 64
"""Rows of numbers are filled up to multiples of this many bytes, a block of real.h."""
SILENT = 1.0
"""Seconds that the compiler may take without a word."""
WRONG_GRAPHS = 2
FAILURES = {"DONE": 0, "NO_MEMORY": 1, "WRONG_GRAPHS": WRONG_GRAPHS}
"""The return values of functions, as in library.h."""

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_STRUCTURE = re.compile(r"typedef struct \{([^{}]*)\} (\w+);")
_FUNCTION = re.compile(r"^int (\w+)\(([^()]*)\) \{", re.MULTILINE)
_DECLARATION = re.compile(r"(const )?(?:unsigned )?(\w+) (.*)", re.DOTALL)
_EXPORT = re.compile(r"^EXPORT_(STRUCT|CONSTANTS)\((\w+)", re.MULTILINE)

_threads = 0
_failure = "there is none for this machine"


def available() -> bool:
    """Whether hot paths run compiled; the first call compiles them, which takes seconds."""
    return library(torch.float32) is not None


def function(name: str, dtype: torch.dtype) -> Any:
    """A function of the sources for numbers of a type, or None if nothing can be compiled.

    Contiguous tensors and structures can be passed for pointers.
    """
    found = library(dtype)
    return found and found.functions[name]


def structure(name: str, dtype: torch.dtype) -> Any:
    """A function that makes a structure from all its fields, or None without compiled code.

    Tensors may be given for pointers and arrays. Those that C writes to must be contiguous.
    """
    found = library(dtype)
    return found and found.structures[name]


def constants(group: str, dtype: torch.dtype = torch.float32) -> Mapping[str, int]:
    """Constants of the sources by name; empty if nothing can be compiled."""
    found = library(dtype)
    return found.constants[group] if found else {}


def agree(found: Mapping[str, int], wanted: Mapping[str, int]) -> None:
    """ImportError unless constants have the same values in C and in Python."""
    if wrong := {name: value for name, value in wanted.items() if found.get(name) != value}:
        raise ImportError(
            f"Python has {wrong} and the compiled library {dict(found)}; make them equal"
        )


def suits(*tensors: Tensor) -> bool:
    """Whether C can process tensors (...): `alike` on the CPU, and no graph is being exported."""
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


def threads_worth(work: int, each: int) -> int:
    """The number of threads for some work, of which `each` pays off for one more; at least one."""
    return max(1, min(threads(), work // each))


def use_threads(count: int) -> int:
    """Set the number of threads of compiled code, 0 for torch's; returns the previous setting.

    No result depends on it.
    """
    global _threads
    before, _threads = _threads, count
    return before


@dataclass(frozen=True)
class Interface:
    """The functions, makers of structures, and groups of constants of a library, by name."""

    functions: Mapping[str, Any]
    structures: Mapping[str, Callable[..., Any]]
    constants: Mapping[str, Mapping[str, int]]


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
            f"the kinematics of arms needs compiled code, and {_failure}: install a C compiler "
            "such as gcc (or name yours by CC), or install cgtorch from a wheel for this machine"
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
    agree(found.constants["blocks"], {"BLOCK_BYTES": VECTOR})
    return found


def _switched_on() -> bool:
    return os.environ.get("CGTORCH_NATIVE", "1") != "0"


def _loaded(real: str) -> ctypes.CDLL | None:
    """The library compiled on this machine, or else one from the wheel, or None."""
    global _failure
    try:
        if (name := compiler.found_compiler()) is not None:
            file = compiler.file_name(real, name, compiler.own_target(name))
            path = kept(file)
            if path is None and (found := _from_wheel(real)):
                return found
            return _compiled(name, real, path or folder_of_process() / file)
    except (OSError, subprocess.SubprocessError) as e:
        _failure = f"{name} does not compile it ({' '.join(str(e).split()):.200})"
    return _from_wheel(real)


def _compiled(name: str, real: str, path: Path) -> ctypes.CDLL:
    """The library at a path, where this compiler writes it unless it is there."""
    if not is_whole(path):
        with _told_if_slow(f"compiling the engine for this CPU, once ({real}) ..."):
            compiler.compile_libraries(name, {path: (real, compiler.own_target(name))})
    return ctypes.CDLL(str(path))


@contextmanager
def _told_if_slow(what: str) -> Iterator[None]:
    """Say on the terminal what is waited for, if it takes longer than `SILENT`."""
    timer = Timer(SILENT, lambda: print(what, file=sys.stderr))  # noqa: T201
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


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


def interface_of(library: ctypes.CDLL, sources: str, real: Any) -> Interface:
    """The interface of a library, given its sources and the ctype `real`.

    ImportError if sizes of structures differ.
    """
    text = _COMMENT.sub("", sources)
    types = {"real": real, "float": ctypes.c_float, "double": ctypes.c_double}
    types["int64_t"] = ctypes.c_int64
    bodies = {name: body for body, name in _STRUCTURE.findall(text)}
    structures, groups, functions = {}, {}, {}
    for what, name in _EXPORT.findall(text):
        if what == "CONSTANTS":
            groups[name] = _constants(library, name)
            continue
        structures[name] = _maker(structure := _structure(name, bodies, types))
        size = ctypes.c_int64.in_dll(library, f"size_of_{name}").value
        if size != ctypes.sizeof(structure):
            raise ImportError(
                f"structure {name} of the compiled library has {size} bytes and that of the "
                f"sources {ctypes.sizeof(structure)}; delete the library from the cache"
            )
    for name, arguments in _FUNCTION.findall(text):
        functions[name] = getattr(library, name)
        functions[name].restype = ctypes.c_int
        functions[name].argtypes = [
            _Pointer if "*" in each else types[each.split()[0]] for each in arguments.split(",")
        ]
    return Interface(functions, structures, groups)


class _Pointer(ctypes.c_void_p):
    """A pointer, for which a contiguous tensor, a structure, an array or None may be passed."""

    @classmethod
    def from_param(cls, value: Any) -> "_Pointer":
        return cls(_address(value))


class _ReadPointer(_Pointer):
    """A pointer to memory that C does not write to."""


def _structure(name: str, bodies: Mapping[str, str], types: dict[str, Any]) -> Any:
    """The class of a structure; it and all structures within it are entered in `types`."""
    if name not in types:
        fields = []
        for declaration in bodies[name].split(";")[:-1]:
            constant, base, names = _DECLARATION.findall(declaration.strip())[0]
            for each in names.split(","):
                field, _, count = each.strip(" *]").partition("[")
                kind: Any = _ReadPointer if constant else _Pointer
                if "*" not in each:
                    kind = types.get(base) or _structure(base, bodies, types)
                fields.append((field, kind * int(count) if count else kind))
        types[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return types[name]


def _maker(structure: Any) -> Callable[..., Any]:
    """A fast function that makes a structure from all its fields."""
    kinds = dict(structure._fields_)
    read = [name for name, kind in kinds.items() if kind is _ReadPointer]
    written = [name for name, kind in kinds.items() if kind is _Pointer]
    arrays = [name for name, kind in kinds.items() if issubclass(kind, ctypes.Array)]

    def made(**fields: Any) -> Any:
        if fields.keys() != kinds.keys():
            wrong = ", ".join(sorted(fields.keys() ^ kinds.keys()))
            raise TypeError(f"{structure.__name__} differs in fields {wrong}")
        kept = list(fields.values())
        devices = {str(value.device) for value in kept if isinstance(value, Tensor)}
        if len(devices) > 1:  # which would crash the process
            where = " and ".join(sorted(devices))
            raise ValueError(f"tensors of {structure.__name__} are on {where}; move them")
        for name in read:
            if isinstance(value := fields[name], Tensor):
                kept.append(value := value.contiguous())
                fields[name] = value.data_ptr()
            else:
                fields[name] = _address(value)
        for name in written:
            fields[name] = _address(fields[name])
        for name in arrays:
            fields[name] = tuple(fields[name].tolist())
        filled = structure(**fields)
        filled.kept = kept
        return filled

    return made


def _constants(library: ctypes.CDLL, group: str) -> dict[str, int]:
    text = ctypes.c_char.in_dll(library, f"names_of_{group}")
    names = ctypes.string_at(ctypes.addressof(text)).decode().split(", ")
    values = (ctypes.c_int64 * len(names)).in_dll(library, f"values_of_{group}")
    return dict(zip(names, values, strict=True))


def _address(value: Any) -> int | None:
    if value is None:
        return None
    if not isinstance(value, Tensor):
        return ctypes.addressof(value)
    if not value.is_contiguous():
        raise ValueError(f"a tensor {tuple(value.shape)} is not contiguous; call contiguous()")
    return value.data_ptr()
