"""The tutorial runs from its first file to its last command, with short trainings."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from command_line import ROOT, Shell

PAGE = ROOT / "docs" / "tutorial.md"
SHORT = "--target 0.6 --practice 8 --attempts 12 --generations 40"


def ran(line: str, folder: Path, shell: Shell) -> str:
    """What a line of the page prints, run as it stands there; Python in a process of its own."""
    name, *rest = shlex.split(line)
    if name != "python":
        return shell.does(name, *rest, *(shlex.split(SHORT) if name == "cgtorch-train" else [])).out
    ended = subprocess.run(
        [sys.executable, *rest],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, f"{line}\n{ended.stdout}\n{ended.stderr}"
    return ended.stdout


def test_the_tutorial(tmp_path: Path, shell: Shell) -> None:
    text = PAGE.read_text()
    files = dict(re.findall(r"^```python\n# (\w+\.py)\n(.*?)^```", text, re.M | re.S))
    assert set(files) == {"puck.py", "try_puck.py", "windy.py"}
    for name, code in files.items():
        (tmp_path / name).write_text(code)
    lines = [
        line.strip() for line in text.splitlines() if re.match(r"    (cgtorch-|python )", line)
    ]
    printed = {line: ran(line, tmp_path, shell) for line in lines}
    assert re.fullmatch(
        r"tensor\(\[(?:\s*(?:True|False),?){3}\]\)\n", printed["python try_puck.py"]
    )
    (evaluated,) = (out for line, out in printed.items() if line.startswith("cgtorch-evaluate"))
    succeeded, tried = map(int, re.findall(r"(\d+) */ *(\d+)", evaluated)[0])
    assert tried == 1000
    assert succeeded > 500
    for name in ("puck.html", "puck.mmd", "puck_skill.py"):
        assert (tmp_path / name).stat().st_size > 100
