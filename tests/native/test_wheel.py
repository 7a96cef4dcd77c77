"""A wheel has the C sources compiled, and says so: where it is installed no compiler is needed."""

import os
import platform
import subprocess
import sys
import zipfile
from collections.abc import Collection
from itertools import product
from pathlib import Path

import pytest
import torch
from quick_compiler import quick_compiler

from cgtorch.native import compiler

ROOT = Path(__file__).parents[2]
ABLE = torch.backends.cpu.get_cpu_capability()
WHERE = (platform.system(), platform.machine()) == ("Linux", "x86_64") and ABLE in compiler.TARGETS

pytestmark = pytest.mark.skipif(
    not WHERE or compiler.found_compiler() is None, reason="wheels have libraries for x86-64 only"
)

ASKED = """
import torch
import cgtorch
from cgtorch.native import available
from cgtorch.svm import SVR
x = torch.randn(60, 3, generator=torch.Generator().manual_seed(0))
machine = SVR(10.0, gamma=0.5).fit(x, x.sin().sum(1)).float()
print(cgtorch.__file__, available(), float(machine.values(x[:1])[0, 0]))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel that was built here for this CPU, unpacked."""
    return built(tmp_path_factory.mktemp("wheel"), [ABLE])


def built(folder: Path, targets: Collection[str], **environment: str) -> Path:
    """A wheel that was built in `folder`, unpacked; only libraries for this CPU have contents."""
    (other,) = (options[0] for name, options in compiler.TARGETS.items() if name != ABLE)
    command = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps"]
    own = {"CC": quick_compiler(folder, other), **environment}
    log = subprocess.run(
        [*command, "--no-build-isolation", "-v", "-w", str(folder)], check=True,
        env={**os.environ, **own}, capture_output=True, text=True,
    ).stderr  # fmt: skip
    files, libraries = len(list(compiler.SOURCES.rglob("*.c"))), len(targets) * len(compiler.REALS)
    assert f"compiles {libraries * files} objects: {files} C files" in log
    assert f"CPUs with {' and '.join(targets)}" in log
    assert "compiled in " in log
    (wheel,) = folder.glob("*.whl")
    assert wheel.name.endswith("-linux_x86_64.whl")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder / "unpacked")
    return folder / "unpacked"


def libraries(installed: Path) -> set[str]:
    """The names of the libraries in a wheel."""
    return {path.name for path in (installed / "cgtorch" / "native" / "compiled").iterdir()}


def said(installed: Path, tmp_path: Path, **environment: str) -> tuple[bool, float]:
    """Whether anything is compiled where nothing but the wheel is known, and a prediction."""
    own = {"PYTHONPATH": str(installed), "XDG_CACHE_HOME": str(tmp_path)}
    told = subprocess.run(
        [sys.executable, "-c", ASKED], check=True, capture_output=True, text=True, cwd=tmp_path,
        env={**os.environ, **own, **environment},
    ).stdout  # fmt: skip
    path, yes, value = told.split()
    assert Path(path).is_relative_to(installed)
    return yes == "True", float(value)


@pytest.mark.hostile
def test_no_compiler_is_needed(installed: Path, tmp_path: Path) -> None:
    compiled, value = said(installed, tmp_path, CC="no-such-compiler")
    assert compiled
    assert not list(tmp_path.rglob("*.so"))
    in_torch = said(installed, tmp_path, CC="no-such-compiler", CGTORCH_NATIVE="0")
    assert in_torch == (False, pytest.approx(value, abs=1e-5))
    assert in_torch[1] != value  # which it would be if it had not come from the library


def test_libraries_of_other_sources_are_left_alone(installed: Path, tmp_path: Path) -> None:
    source = installed / "cgtorch" / "native" / "real.h"
    text = source.read_text()
    source.write_text(text + "\n/* changed */\n")
    try:
        assert not said(installed, tmp_path, CC="no-such-compiler")[0]
    finally:
        source.write_text(text)


@pytest.mark.hostile
def test_a_wheel_for_others_has_libraries_for_all_cpus(tmp_path: Path) -> None:
    pairs = product(compiler.REALS, compiler.TARGETS)
    found = libraries(built(tmp_path, compiler.TARGETS, CGTORCH_CPUS="all"))
    assert found == {compiler.wheel_file_name(*pair) for pair in pairs}


def test_libraries_for_this_cpu_and_all_sources_are_in_it(installed: Path) -> None:
    native = installed / "cgtorch" / "native"
    found = {compiler.wheel_file_name(real, ABLE) for real in compiler.REALS}
    assert libraries(installed) == found
    for path in [*compiler.SOURCES.rglob("*.[ch]"), *compiler.SOURCES.rglob("*.cu")]:
        assert (native / path.relative_to(compiler.SOURCES)).read_bytes() == path.read_bytes()
