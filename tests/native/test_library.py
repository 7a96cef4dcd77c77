"""Compiled code: where it comes from, and that nothing needs it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from quick_compiler import quick_compiler

from cgtorch.native import available

WITHOUT = """
import torch
from cgtorch.native import function
from cgtorch.svm import SVR
x = torch.randn(60, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
machine = SVR(10.0, gamma=0.5).fit(x, x.sin().sum(1))
print(function("rbf_values", x.dtype) is not None, repr(float(machine.values(x[:1])[0, 0])))
"""


def said(**environment: str) -> tuple[bool, float]:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    yes, value = done.stdout.split()
    return yes == "True", float(value)


@pytest.mark.skipif(not available(), reason="there is no C compiler")
def test_it_is_compiled_once_into_the_cache(tmp_path: Path) -> None:
    where = {"XDG_CACHE_HOME": str(tmp_path), "CC": quick_compiler(tmp_path)}
    yes, value = said(**where)
    assert yes
    made = {path: path.stat().st_mtime_ns for path in (tmp_path / "cgtorch").iterdir()}
    assert made
    assert all(path.suffix == ".so" for path in made)
    assert (tmp_path / "cgtorch").stat().st_mode & 0o077 == 0
    assert said(**where) == (yes, value)
    again = {path: path.stat().st_mtime_ns for path in (tmp_path / "cgtorch").iterdir()}
    assert again == made


def test_without_a_compiler_torch_says_the_same(tmp_path: Path) -> None:
    _, value = said()
    for environment in (
        {"CGTORCH_NATIVE": "0"},
        {"CC": "no-such-compiler", "XDG_CACHE_HOME": str(tmp_path)},
        {"CC": "false", "XDG_CACHE_HOME": str(tmp_path)},
    ):
        found, plain = said(**environment)
        assert not found
        assert plain == pytest.approx(value, abs=1e-12)


def test_a_cache_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    _, value = said()
    found, plain = said(XDG_CACHE_HOME=str(tmp_path / "file"))
    assert not found
    assert plain == pytest.approx(value, abs=1e-12)
