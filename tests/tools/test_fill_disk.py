"""Running out of disk: the tool fills small file systems only, and leaves them as they were."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from fill_disk import LARGEST, ballast, capacity, command, used

BLOCK = 4096


def test_a_large_file_system_is_never_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = SimpleNamespace(f_blocks=LARGEST // BLOCK + 1, f_frsize=BLOCK, f_bavail=3)
    monkeypatch.setattr(os, "statvfs", lambda path: large)
    assert capacity(tmp_path) == LARGEST + BLOCK
    result = CliRunner().invoke(command, [str(tmp_path)])
    assert result.exit_code == 1
    assert "that may be filled" in result.output
    assert not list(tmp_path.iterdir())


def test_so_much_is_taken_and_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    about = SimpleNamespace(f_blocks=0, f_frsize=BLOCK, f_bavail=100)
    monkeypatch.setattr(os, "statvfs", lambda path: about)
    with ballast(tmp_path, 30 * BLOCK):
        assert used(tmp_path) == 70 * BLOCK
    assert not list(tmp_path.iterdir())
