"""What takes long to make is made by one of the processes that run tests, and read by all."""

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

KEPT = "CGTORCH_MADE_ONCE"
"""The variable of the environment that names a folder with what was made before, if any was."""


def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of this run of tests; pytest-xdist gives each process one of its own in it."""
    if KEPT in os.environ:
        return Path(os.environ[KEPT])
    base = tmp_path_factory.getbasetemp()
    return base.parent if base.name.startswith("popen-") else base


def made_once(path: Path, make: Callable[[Path], None]) -> Path:
    """`path`, which the first process that asks for it makes while others wait.

    `make` gets another path, which is renamed once it is complete.
    """
    with path.with_name(f"{path.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            unfinished = path.with_name(f"{path.name}.unfinished")
            shutil.rmtree(unfinished, ignore_errors=True)  # what a failure left
            make(unfinished)
            unfinished.rename(path)
    return path
