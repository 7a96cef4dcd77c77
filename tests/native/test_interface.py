"""What Python knows of the compiled sources is what the compiler knows of them."""

import ctypes
from pathlib import Path
from typing import Any

import pytest
import torch

from cgtorch.evolution import STRATEGY
from cgtorch.native import available, compiler, constants, function, library, structure
from cgtorch.native.interface import agree, interface_of
from cgtorch.simulation.action_table import FAILURE, SUCCESS, TIMEOUT

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SOURCES = b"".join(path.read_bytes() for path in sorted(compiler.SOURCES.rglob("*.[ch]"))).decode()
MACHINE = {"centres": None, "weights": None, "bias": None, "scale": 2.0, "m": 8, "d": 4, "k": 1}


@pytest.fixture
def compiled() -> ctypes.CDLL:
    assert library.library(torch.float64) is not None
    return ctypes.CDLL(str(library._kept("double")))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_functions_structures_and_constants_are_those_of_the_sources(dtype: torch.dtype) -> None:
    machine = structure("Machine", dtype)(**MACHINE)
    assert (machine.scale, machine.m, machine.d, machine.k) == (2.0, 8, 4, 1)
    assert len(function("rbf_values", dtype).argtypes) == 6
    assert constants("strategy") == {name.upper(): i for i, name in enumerate(STRATEGY)}
    assert constants("ends") == {"SUCCESS": SUCCESS, "FAILURE": FAILURE, "TIMEOUT": TIMEOUT}
    assert list(constants("action_kinds").values()) == list(range(11))


@pytest.mark.parametrize(
    ("field", "instead"),
    [
        ("int64_t m, d, k;", "int64_t m, d;"),
        ("int64_t m, d, k;", "int64_t m, d, k, more;"),
        ("real mean[4], scale[4]", "real mean[4], scale[3]"),
    ],
)
def test_a_structure_of_another_size_is_refused(
    compiled: ctypes.CDLL, field: str, instead: str
) -> None:
    assert field in SOURCES
    interface_of(compiled, SOURCES, ctypes.c_double)
    with pytest.raises(ImportError, match=r"structure \w+ of the compiled library has \d+ bytes"):
        interface_of(compiled, SOURCES.replace(field, instead), ctypes.c_double)


def test_numbers_of_another_type_are_refused(compiled: ctypes.CDLL) -> None:
    with pytest.raises(ImportError, match="structure"):
        interface_of(compiled, SOURCES, ctypes.c_float)


@pytest.mark.parametrize("wrong", [{"SUCCESS": 1}, {"LOST": -4}])
def test_constants_that_differ_are_refused(wrong: dict[str, int]) -> None:
    agree(constants("ends"), {"FAILURE": FAILURE})
    with pytest.raises(ImportError, match=next(iter(wrong))):
        agree(constants("ends"), {"FAILURE": FAILURE, **wrong})


@pytest.mark.parametrize(
    "fields", [{**MACHINE, "more": 1}, {n: v for n, v in MACHINE.items() if n != "bias"}]
)
def test_all_fields_have_to_be_given(fields: dict[str, Any]) -> None:
    with pytest.raises(TypeError, match=r"Machine differs in fields (more|bias)"):
        structure("Machine", torch.float64)(**fields)


@pytest.mark.parametrize("moved", ["centres", "weights"])
def test_tensors_of_a_structure_have_to_be_on_one_device(moved: str) -> None:
    """Addresses of two memories would crash the process."""
    fields = {**MACHINE, "centres": torch.zeros(8, 4), "weights": torch.zeros(8, 1)}
    assert structure("Machine", torch.float32)(**fields).m == 8
    fields[moved] = fields[moved].to("meta")
    with pytest.raises(ValueError, match="tensors of Machine are on cpu and meta; move them"):
        structure("Machine", torch.float32)(**fields)


def test_what_c_writes_to_must_be_contiguous() -> None:
    call, x = function("deviation", torch.float32), torch.zeros(3, 4)
    with pytest.raises(ctypes.ArgumentError, match="not contiguous"):
        call(x.T, 4, 3, torch.empty(3), 1)
    room = torch.zeros(4, 3).T
    fields = dict.fromkeys(("action", "edges", "start"), torch.zeros(3, dtype=torch.long))
    with pytest.raises(ValueError, match="not contiguous"):
        structure("Graphs", torch.float32)(**fields, origins=room, nodes=3, outcomes=3)


def test_sources_are_shipped() -> None:
    """Where Python finds them, however they are sorted into folders."""
    folders = {path.parent.name for path in compiler.SOURCES.rglob("*.c")}
    assert folders == {"native", "engine", "svm", "improvement", "tabletop"}
    assert all(Path(path).is_file() for path in compiler.SOURCES.rglob("*.h"))
