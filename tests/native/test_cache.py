"""What is taken from the cache of compiled code."""

import shutil
import sys
from pathlib import Path

import pytest

from cgtorch.native.cache import ELF, HEADER, MACH, is_whole


@pytest.mark.parametrize("begin", [b"", b"\x00" * HEADER, b"#!/bin/sh\n", ELF])
def test_what_is_no_whole_library_is_made_anew(begin: bytes, tmp_path: Path) -> None:
    path = tmp_path / "engine.so"
    path.write_bytes(begin + b"\xff" * 600_000)
    assert not is_whole(path)


def test_a_whole_library_is_taken_and_one_that_was_cut_is_not(tmp_path: Path) -> None:
    path = tmp_path / "engine.so"
    path.write_bytes(MACH[0] + bytes(600_000))
    assert is_whole(path)
    shutil.copy(sys.executable, path)
    assert is_whole(path) or not path.read_bytes().startswith(ELF)
    path.write_bytes(path.read_bytes()[:-100])
    assert not is_whole(path) or not path.read_bytes().startswith(ELF)
