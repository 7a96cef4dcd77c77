"""A file in the current folder is not taken for a module of Python's."""

import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import sys
sys.path = [each for each in sys.path if each]
from cgtorch.commands.standard_modules import import_from_here
import_from_here(["tabletop"])
assert "" not in sys.path
import_from_here([{spec!r}])
import {module}
print({module}.__file__)
"""


@pytest.mark.parametrize(
    ("spec", "module", "own"),
    [
        ("gymnasium:CartPole-v1", "queue", False),
        ("gymnasium:mine:Mine-v0", "queue", False),
        ("gymnasium:mine:Mine-v0+wrap:scaled", "wave", False),
        ("gymnasium:mine:Mine-v0+wave:scaled", "wave", True),
        ("wave:Cart", "wave", True),
        ("mine:Cart", "mine", True),
        ("mine:Cart", "click", True),  # of other packages, too
        ("mine:Cart", "test", True),
    ],
)
def test_files_are_found_after_modules_of_python(
    tmp_path: Path, spec: str, module: str, own: bool
) -> None:
    code = CODE.format(spec=spec, module=module)
    for name in ("queue", "wave", "mine", "click", "test"):
        (tmp_path / f"{name}.py").write_text("own = True")
    path = ":".join(each for each in sys.path if each)
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=tmp_path,
        env={"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (Path(done.stdout.strip()).parent == tmp_path) == own
