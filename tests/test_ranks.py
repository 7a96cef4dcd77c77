"""Several ranks come to what one does, to the last bit."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from trained import SMALL, trained_run

from cgtorch import ranks

GATHER = """
import torch
from cgtorch import ranks

with ranks.together():
    assert ranks.count() == 5
    for rows in range(13):
        for whole in (
            torch.arange(rows),
            torch.arange(rows * 3.0).view(rows, 3),
            torch.arange(rows) % 2 == 0,
        ):
            part = whole[ranks.share(rows)]
            assert torch.equal(ranks.gathered(part, rows), whole)
            assert ranks.gathered(part, rows).dtype == whole.dtype
    assert ranks.agreed(ranks.first())
    ranks.wait()
    if ranks.first():
        print("all gathered")
"""


def torchrun(count: int, *words: str) -> str:
    """What so many ranks print."""
    program = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    ended = subprocess.run(
        [*program, f"--nproc-per-node={count}", *words],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr[-3000:]
    return ended.stdout + ended.stderr


def test_alone_everything_is_ones_own() -> None:
    rows = torch.arange(7)
    with ranks.together():
        assert ranks.count() == 1
        assert ranks.first()
        assert ranks.share(7) == slice(0, 7)
        assert ranks.gathered(rows, 7) is rows
        assert ranks.agreed(True)
        assert not ranks.agreed(False)
        ranks.wait()


def test_uneven_parts_are_gathered_in_order(tmp_path: Path) -> None:
    (tmp_path / "gather.py").write_text(GATHER)
    assert "all gathered" in torchrun(5, str(tmp_path / "gather.py"))


@pytest.fixture(scope="session")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained_run(tmp_path_factory.getbasetemp()).folder


@pytest.mark.parametrize("count", [2, 3])
def test_any_number_of_ranks_makes_the_same_run(count: int, alone: Path, tmp_path: Path) -> None:
    """60 individuals and 13 scenarios do not divide evenly by all of these."""
    given = {k: v for k, v in SMALL.to_dict().items() if v != getattr(type(SMALL), k, None)}
    options = [
        part
        for name, value in given.items()
        if name != "actions"
        for part in (f"--{name.replace('_', '-')}", str(value))
    ]
    run = tmp_path / "run"
    words = ["-m", "cgtorch.commands.train", "--stage", "S0", "--quiet", "--run-dir", str(run)]
    printed = torchrun(count, *words, *options)
    assert printed.count("S0     perimeter") == 1  # only one of them says so
    for name in ("start/gamma", "start/classifier", "S0/data", "S0/specialists"):
        path = f"{name}.safetensors"
        assert (run / path).read_bytes() == (alone / path).read_bytes(), path
    for path in ("S0/skill.json", "S0/scenarios.json", "ledger/S0.json"):
        assert (run / path).read_bytes() == (alone / path).read_bytes(), path
    assert len(list(run.glob("events.*"))) == 1
