"""Compiled code: where it comes from, that nothing needs it, and what Python knows of it."""

import ctypes
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from quick_compiler import quick_compiler

from cgtorch.evolution import STRATEGY
from cgtorch.ground.errors import CompilerError
from cgtorch.native import (
    agree,
    available,
    cache,
    compiler,
    constants,
    function,
    library,
    structure,
)
from cgtorch.simulation.program import FAILURE, SUCCESS, TIMEOUT

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SOURCES = compiler.sources().decode()
MACHINE = {"centres": None, "weights": None, "bias": None, "scale": 2.0, "m": 8, "d": 4, "k": 1}


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A compiler that compiles each source once for all these tests."""
    return quick_compiler(tmp_path_factory.mktemp("compiler"))


@pytest.fixture(autouse=True)
def folder_of_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What would be the folder of this process is the test's."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    cache.folder_of_process.cache_clear()
    yield
    cache.folder_of_process.cache_clear()


def found_anew(monkeypatch: pytest.MonkeyPatch, **environment: str) -> Any:
    """What a process with these variables would find."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(library, "built", getattr(library.built, "__wrapped__", library.built))
    return library.library(torch.float32)


def test_it_is_compiled_once_into_the_cache_and_that_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    quick: str,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(library, "SILENT", 0.0)
    found = found_anew(monkeypatch, CC=quick)
    assert capsys.readouterr().err == "compiling the engine for this CPU, once (float) ...\n"
    assert found.functions.keys() >= {"rbf_values", "rbf_gram"}
    (made,) = (tmp_path / "cgtorch").iterdir()
    assert made.suffix == ".so"
    assert (tmp_path / "cgtorch").stat().st_mode & 0o077 == 0
    time = made.stat().st_mtime_ns
    assert found_anew(monkeypatch)
    assert made.stat().st_mtime_ns == time
    assert list((tmp_path / "cgtorch").iterdir()) == [made]
    assert not capsys.readouterr().err


@pytest.mark.parametrize("harm", ["empty", "cut", "another's", "anybody's", "link"])
def test_what_is_not_whole_or_not_ones_own_is_compiled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick: str, harm: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", quick)
    assert found_anew(monkeypatch)
    (made,) = (tmp_path / "cgtorch").iterdir()
    whole, evil = made.read_bytes(), tmp_path / "evil"
    made.unlink()  # it is loaded, so that it must not be changed in its place
    made.write_bytes({"empty": b"", "cut": whole[:-100]}.get(harm, whole))
    made.chmod(0o777 if harm == "anybody's" else 0o755)
    if harm == "link":
        made.rename(evil)
        made.symlink_to(evil)
    if harm == "another's":
        if os.geteuid() != 0:
            pytest.skip("only root can give folders away")
        os.chown(tmp_path / "cgtorch", 12345, 12345)
    assert found_anew(monkeypatch)
    if harm == "another's":  # in a folder of this user's own
        assert (tmp_path / "cgtorch-0" / made.name).exists()
    else:
        assert made.stat().st_mode & 0o022 == 0
        assert not made.is_symlink()
        assert len(made.read_bytes()) > len(whole) // 2


def test_a_cache_that_belongs_to_others_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick: str
) -> None:
    own = os.geteuid()
    monkeypatch.setattr("os.geteuid", lambda: own + 1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert found_anew(monkeypatch, CC=quick)
    assert not list((tmp_path / f"cgtorch-{own + 1}").iterdir())


def test_where_no_cache_can_be_written_the_process_has_its_own(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    quick: str,
) -> None:
    monkeypatch.setattr(library, "SILENT", 1e9)
    for _ in range(2):
        assert found_anew(monkeypatch, CC=quick, XDG_CACHE_HOME=os.devnull)
    (folder,) = tmp_path.iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    assert [path.suffix for path in folder.iterdir()] == [".so"]
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("cannot write the cache in '/dev/null': compiling into a temporary fol")
    cache._remove(folder, os.getpid() + 1)  # as a fork would
    assert folder.exists()
    cache._remove(folder, os.getpid())
    assert not folder.exists()


def test_why_it_is_not_compiled_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "_failure", "")
    assert not found_anew(monkeypatch, CC="false", XDG_CACHE_HOME=str(tmp_path))
    with pytest.raises(CompilerError, match=r"needs compiled code, and .*/false does not compile"):
        library.required(torch.float32)


@pytest.mark.parametrize(
    "environment",
    [{"CGTORCH_NATIVE": "0"}, {"CC": "no-such-compiler"}, {"CC": "false"}],
    ids=str,
)
def test_without_a_compiler_nothing_is_found_and_that_is_no_error(
    environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not found_anew(monkeypatch, **(environment | {"XDG_CACHE_HOME": str(tmp_path)}))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_functions_structures_and_constants_are_those_of_the_sources(dtype: torch.dtype) -> None:
    machine = structure("Machine", dtype)(**MACHINE)
    assert (machine.scale, machine.m, machine.d, machine.k) == (2.0, 8, 4, 1)
    assert len(function("rbf_values", dtype).argtypes) == 6
    assert constants("strategy") == {name.upper(): i for i, name in enumerate(STRATEGY)}
    assert constants("ends") == {"SUCCESS": SUCCESS, "FAILURE": FAILURE, "TIMEOUT": TIMEOUT}
    assert list(constants("action_kinds").values()) == list(range(11))


@pytest.mark.parametrize(
    ("field", "instead", "real"),
    [
        ("int64_t m, d, k;", "int64_t m, d;", ctypes.c_double),
        ("int64_t m, d, k;", "int64_t m, d, k, more;", ctypes.c_double),
        ("real mean[4], scale[4]", "real mean[4], scale[3]", ctypes.c_double),
        ("", "", ctypes.c_float),
    ],
)
def test_a_structure_of_another_size_is_refused(field: str, instead: str, real: Any) -> None:
    compiled = library._loaded("double")
    assert field in SOURCES
    library.interface_of(compiled, SOURCES, ctypes.c_double)
    with pytest.raises(ImportError, match=r"structure \w+ of the compiled library has \d+ bytes"):
        library.interface_of(compiled, SOURCES.replace(field, instead), real)


@pytest.mark.parametrize("wrong", [{"SUCCESS": 1}, {"LOST": -4}])
def test_constants_that_differ_are_refused(wrong: dict[str, int]) -> None:
    agree(constants("ends"), {"FAILURE": FAILURE})
    with pytest.raises(ImportError, match=next(iter(wrong))):
        agree(constants("ends"), {"FAILURE": FAILURE, **wrong})


def test_wrong_fields_are_refused() -> None:
    made = structure("Machine", torch.float32)
    with pytest.raises(TypeError, match="Machine differs in fields more"):
        made(**MACHINE, more=1)
    with pytest.raises(TypeError, match="Machine differs in fields bias"):
        made(**{name: value for name, value in MACHINE.items() if name != "bias"})
    tensors = {"centres": torch.zeros(8, 4), "weights": torch.zeros(8, 1)}
    assert made(**MACHINE | tensors).m == 8
    for moved, tensor in tensors.items():
        with pytest.raises(ValueError, match="tensors of Machine are on cpu and meta; move them"):
            made(**MACHINE | tensors | {moved: tensor.to("meta")})


def test_what_c_writes_to_must_be_contiguous() -> None:
    call, x = function("deviation", torch.float32), torch.zeros(3, 4)
    with pytest.raises(ctypes.ArgumentError, match="not contiguous"):
        call(x.T, 4, 3, torch.empty(3), 1)
    room = torch.zeros(4, 3).T
    fields = dict.fromkeys(("action", "edges", "start"), torch.zeros(3, dtype=torch.long))
    with pytest.raises(ValueError, match="not contiguous"):
        structure("Graphs", torch.float32)(**fields, origins=room, nodes=3, outcomes=3)


@pytest.mark.parametrize(
    ("able", "there", "broken", "found"),
    [
        ("AVX512", ["AVX512", "AVX2"], [], "AVX512"),
        ("AVX512", ["AVX2"], [], "AVX2"),
        ("AVX512", ["AVX2"], ["AVX512"], "AVX2"),
        ("AVX2", ["AVX512", "AVX2"], [], "AVX2"),
        ("AVX2", ["AVX512"], [], None),
        ("AVX2", [], ["AVX2"], None),
        ("AVX2", [], [], None),
        ("DEFAULT", ["AVX512", "AVX2"], [], None),
    ],
)
def test_of_a_wheel_the_fastest_library_is_taken_that_this_cpu_can_run(
    able: str,
    there: list[str],
    broken: list[str],
    found: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own = Path(library._loaded("double")._name)
    assert own is not None
    for target in there:
        (tmp_path / compiler.wheel_file_name("double", target)).write_bytes(own.read_bytes())
    for target in broken:
        (tmp_path / compiler.wheel_file_name("double", target)).write_text("no library")
    monkeypatch.setattr(library, "FROM_WHEEL", tmp_path)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: able)
    wanted = found and str(tmp_path / compiler.wheel_file_name("double", found))
    for machine, same in (("AMD64", True), ("x86_64", True), ("aarch64", False)):
        monkeypatch.setattr("platform.machine", lambda machine=machine: machine)
        taken = library._from_wheel("double")
        assert (taken and taken._name) == (wanted if same else None)
