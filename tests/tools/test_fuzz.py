"""Hostile input: its mutations, what counts as a failure, and workers that are lost."""

import random
import subprocess
import sys
from pathlib import Path

import fuzz
import pytest
from click.testing import CliRunner
from fuzz import FORMATS, command, shares
from hostile.formats import PR2, REFERENCE
from hostile.mutations import Mutation, damaged, damaged_json, damaged_tensors, damaged_xml
from hostile.worker import LONGEST, said, wrong

from cgtorch.ground.errors import RunError


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        (damaged_json, REFERENCE / "S0" / "scenarios.json"),
        (damaged_tensors, REFERENCE / "S3" / "gamma.safetensors"),
        (damaged_xml, PR2 / "pr2.urdf"),
    ],
)
def test_a_seed_says_what_becomes_of_a_file(kind: Mutation, path: Path) -> None:
    raw = path.read_bytes()
    found = [damaged(kind, raw, random.Random(i)) for i in range(40)]
    assert found == [damaged(kind, raw, random.Random(i)) for i in range(40)]
    assert len({*found, raw}) > 30


def test_every_format_has_its_least() -> None:
    counts = shares(100_000)
    assert set(counts) == set(FORMATS)
    assert min(counts.values()) >= fuzz.LEAST
    assert 99_000 < sum(counts.values()) < 110_000
    assert min(shares(10 * len(FORMATS)).values()) >= 10


def raises(error: BaseException) -> None:
    raise error


def test_what_is_a_failure() -> None:
    assert said(lambda: 3, []) == ("accepted", "")
    assert said(lambda: raises(RunError("no file")), [])[0] == "refused"
    assert said(lambda: raises(KeyError("x")), []) == ("failed", "KeyError: 'x'")
    assert wrong("one line") is None
    for message in ("", "x" * (LONGEST + 1), "two\nlines", "canary-that-must-not-be-read"):
        found = wrong(message)
        assert found is not None
        assert found[0] == "failed"
    with pytest.raises(SystemExit, match="forbidden: open"):
        said(lambda: None, ["open"])


@pytest.mark.hostile
def test_writing_elsewhere_is_seen(tmp_path: Path) -> None:
    program = (
        "from hostile.worker import watched\nfrom pathlib import Path\nimport sys\n"
        "inside, outside = map(Path, sys.argv[1:])\ncrimes = watched(inside)\n"
        "(inside / 'x').write_text('x')\nassert not crimes\n"
        "(outside / 'x').write_text('x')\nprint(crimes)\n"
    )
    folders = [tmp_path / "inside", tmp_path / "outside"]
    for folder in folders:
        folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, folders)],
        capture_output=True,
        text=True,
        cwd=Path(fuzz.__file__).parent,
    )
    assert "outside/x" in done.stdout, done.stderr


def answers(program: str) -> list[object]:
    worker = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    try:
        return list(fuzz._answers(worker))
    finally:
        worker.kill()
        worker.wait()


def test_a_worker_that_hangs_or_dies_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "PATIENCE", 0.5)
    begins = "import time\nprint('ready\\n[1]', flush=True)\n"
    assert answers(begins + "time.sleep(60)") == [[1]]
    assert answers(begins + "raise SystemExit(3)") == [[1]]


@pytest.mark.hostile
def test_a_few_inputs_of_one_format() -> None:
    result = CliRunner().invoke(command, ["--only", "log", "--count", "12"])
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[1].split()[:2] == ["log", "12"]
