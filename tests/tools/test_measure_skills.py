"""One small run, measured; and the table."""

import shutil
from pathlib import Path

import measure_skills
import pytest
from click.testing import CliRunner

from cgtorch.ground.files import read_json

REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference"


def test_a_run_is_made_once_and_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of a training, the reference run."""
    made = list[Path]()

    def train(words: list[str], check: bool) -> None:
        made.append(Path(words[words.index("--run-dir") + 1]))
        shutil.copytree(REFERENCE, made[-1])

    monkeypatch.setattr(measure_skills.subprocess, "run", train)
    words = [str(tmp_path), "--seeds", "0:1", "--kinds", "auto", "--count", "40"]
    ended = CliRunner().invoke(measure_skills.command, words)
    assert ended.exit_code == 0, ended.output
    result = read_json(tmp_path / "auto-0.json")
    assert result["tried"] == 40
    assert set(result["succeeded"]) == {"perimeter", "near", "left", "right", "far"}
    assert all(20 < count <= 40 for count in result["succeeded"].values())
    assert 0 < result["searching"] < result["improving"]
    table = (tmp_path / "table.md").read_text()
    assert table in ended.output
    assert f"| {result['succeeded']['perimeter'] / 40:.1%} |" in table
    assert CliRunner().invoke(measure_skills.command, words).exit_code == 0
    assert made == [tmp_path / "auto-0"]


def test_the_table_tells_the_median_and_the_least() -> None:
    results = [
        {"kind": "clutter", "tried": 10, "succeeded": {"general-clutter": n}}
        | {"seconds": 60.0 + n, "searching": 10.0 * n, "w_lost": n, "nodes": n, "largest": 2 * n}
        for n in (9, 7, 8)
    ]
    cells = [cell.strip() for cell in measure_skills.table(results).splitlines()[-1].split("|")]
    assert cells[2:-1] == ["general-clutter", "80.0%", "70.0%", "3", "68, 90", "24", "9, 18"]
    assert len(measure_skills.table([]).splitlines()) == 2
