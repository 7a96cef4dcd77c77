"""The small run that is trained once."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import Shell
from trained import Trained, trained_run


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A run up to S1; its folder is not to be changed."""
    return trained_run(tmp_path_factory)


@pytest.fixture
def shell(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Shell]:
    """Runs commands in an empty folder; what they import from there is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    yield Shell(monkeypatch, capsys)
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]
