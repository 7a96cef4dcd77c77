"""The interface between Python and C: functions, structures and constants, each written once.

Functions and structures are parsed from the sources. Constants and the sizes of structures come
from the compiled library itself (library.h). If sizes differ, the library is refused.
"""

import ctypes
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_STRUCTURE = re.compile(r"typedef struct \{([^{}]*)\} (\w+);")
_FUNCTION = re.compile(r"^int (\w+)\(([^()]*)\) \{", re.MULTILINE)
_DECLARATION = re.compile(r"(const )?(?:unsigned )?(\w+) (.*)", re.DOTALL)
_EXPORT = re.compile(r"^EXPORT_(STRUCT|CONSTANTS)\((\w+)", re.MULTILINE)


class Pointer(ctypes.c_void_p):
    """A pointer, for which a contiguous tensor, a structure, an array or None may be passed."""

    @classmethod
    def from_param(cls, value: Any) -> "Pointer":
        """The address that is passed to a function."""
        return cls(_address(value))


class ReadPointer(Pointer):
    """A pointer to memory that C does not write to."""


@dataclass(frozen=True)
class Interface:
    """The contents of a compiled library.

    Attributes:
        functions: By name; tensors and structures may be passed for pointers.
        structures: Functions, by name, that make a structure from all its fields: numbers,
            structures, and tensors for pointers and arrays. Structures keep their tensors alive;
            those that C writes to must be contiguous.
        constants: Groups, by name, of values by name.
    """

    functions: Mapping[str, Any]
    structures: Mapping[str, Callable[..., Any]]
    constants: Mapping[str, Mapping[str, int]]


def interface_of(library: ctypes.CDLL, sources: str, real: Any) -> Interface:
    """The interface of a library, given its sources and the ctype `real`.

    ImportError if sizes of structures differ.
    """
    text = _COMMENT.sub("", sources)
    types = {"real": real, "float": ctypes.c_float, "double": ctypes.c_double}
    types["int64_t"] = ctypes.c_int64
    bodies = {name: body for body, name in _STRUCTURE.findall(text)}
    exported = _EXPORT.findall(text)
    structures = {}
    for name in (name for what, name in exported if what == "STRUCT"):
        structures[name] = _maker(structure := _structure(name, bodies, types))
        size = ctypes.c_int64.in_dll(library, f"size_of_{name}").value
        if size != ctypes.sizeof(structure):
            raise ImportError(
                f"structure {name} of the compiled library has {size} bytes and that of the "
                f"sources {ctypes.sizeof(structure)}; delete the library from the cache"
            )
    functions = {}
    for name, arguments in _FUNCTION.findall(text):
        functions[name] = getattr(library, name)
        functions[name].restype = ctypes.c_int
        functions[name].argtypes = [
            Pointer if "*" in each else types[each.split()[0]] for each in arguments.split(",")
        ]
    groups = [name for what, name in exported if what == "CONSTANTS"]
    return Interface(functions, structures, {name: _constants(library, name) for name in groups})


def agree(found: Mapping[str, int], wanted: Mapping[str, int]) -> None:
    """ImportError unless constants have the same values in C and in Python."""
    if wrong := {name: value for name, value in wanted.items() if found.get(name) != value}:
        raise ImportError(
            f"Python has {wrong} and the compiled library {dict(found)}; make them equal"
        )


def _structure(name: str, bodies: Mapping[str, str], types: dict[str, Any]) -> Any:
    """The class of a structure; it and all structures within it are entered in `types`."""
    if name not in types:
        fields = []
        for declaration in bodies[name].split(";")[:-1]:
            constant, base, names = _DECLARATION.findall(declaration.strip())[0]
            for each in names.split(","):
                field, _, count = each.strip(" *]").partition("[")
                kind: Any = ReadPointer if constant else Pointer
                if "*" not in each:
                    kind = types.get(base) or _structure(base, bodies, types)
                fields.append((field, kind * int(count) if count else kind))
        types[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return types[name]


def _maker(structure: Any) -> Callable[..., Any]:
    """A fast function that makes a structure from all its fields."""
    kinds = dict(structure._fields_)
    read = [name for name, kind in kinds.items() if kind is ReadPointer]
    written = [name for name, kind in kinds.items() if kind is Pointer]
    arrays = [name for name, kind in kinds.items() if issubclass(kind, ctypes.Array)]

    def made(**fields: Any) -> Any:
        if fields.keys() != kinds.keys():
            wrong = ", ".join(sorted(fields.keys() ^ kinds.keys()))
            raise TypeError(f"{structure.__name__} differs in fields {wrong}")
        kept = list(fields.values())
        _check_devices(structure.__name__, kept)
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


def _check_devices(name: str, values: list[Any]) -> None:
    """ValueError if tensors are on several devices, which would crash the process."""
    devices = {str(value.device) for value in values if isinstance(value, Tensor)}
    if len(devices) > 1:
        raise ValueError(f"tensors of {name} are on {' and '.join(sorted(devices))}; move them")


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
