"""The tutorial runs from its first file to its last command, with short trainings."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "tutorial.md"
SHORT = "--target 0.6 --practice 8 --attempts 12 --generations 40"


def ran(words: list[str], folder: Path) -> str:
    """What a command of the page prints, run as it stands there."""
    name, *rest = words
    module = name if name == "python" else f"cgtorch.commands.{name.removeprefix('cgtorch-')}"
    start = [sys.executable] if name == "python" else [sys.executable, "-m", module]
    short = shlex.split(SHORT) if name == "cgtorch-train" else []
    ended = subprocess.run(
        [*start, *rest, *short],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, f"{shlex.join(words)}\n{ended.stdout}\n{ended.stderr}"
    return ended.stdout


def test_the_tutorial(tmp_path: Path) -> None:
    text = PAGE.read_text()
    files = dict(re.findall(r"^```python\n# (\w+\.py)\n(.*?)^```", text, re.M | re.S))
    assert set(files) == {"puck.py", "try_puck.py", "windy.py"}
    for name, code in files.items():
        (tmp_path / name).write_text(code)
    lines = [
        line.strip() for line in text.splitlines() if re.match(r"    (cgtorch-|python )", line)
    ]
    printed = {line: ran(shlex.split(line), tmp_path) for line in lines}
    assert re.fullmatch(
        r"tensor\(\[(?:\s*(?:True|False),?){3}\]\)\n", printed["python try_puck.py"]
    )
    (evaluated,) = (out for line, out in printed.items() if line.startswith("cgtorch-evaluate"))
    succeeded, tried = map(int, re.findall(r"(\d+) */ *(\d+)", evaluated)[0])
    assert tried == 1000
    assert succeeded > 500
    for name in ("puck.html", "puck.mmd", "puck_skill.py"):
        assert (tmp_path / name).stat().st_size > 100
