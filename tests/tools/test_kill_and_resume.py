"""A training under `kill -9` ends as one left alone; the tool itself does it often."""

from pathlib import Path

import kill_and_resume
import pytest
from click.testing import CliRunner
from kill_and_resume import command, results_of, timeless


def test_a_training_that_is_killed_ends_as_one_left_alone(tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(tmp_path), "--kills", "1", "--stage", "S0"])
    assert result.exit_code == 0, result.output
    assert "the same" in result.output
    found = results_of(tmp_path / "alone")
    assert {"S0/skill.json", "S0/scenarios.json", "log.jsonl"} <= set(found)
    assert {"start/data.safetensors", "S0/gamma.safetensors"} <= set(found)
    assert {"generation", "accepted", "result"} <= {row["event"] for row in found["log.jsonl"]}
    assert not list(tmp_path.glob("*/journal/S0"))


def test_a_difference_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def train(run: Path, words: list[str], seconds: float | None = None) -> bool:
        run.mkdir(parents=True)
        return True

    results = iter([{"S0/skill.json": 1, "x": 2}, {"S0/skill.json": 3, "x": 2}])
    monkeypatch.setattr(kill_and_resume, "train", train)
    monkeypatch.setattr(kill_and_resume, "results_of", lambda run: next(results))
    result = CliRunner().invoke(command, [str(tmp_path)])
    assert result.exit_code == 1
    assert "differs in S0/skill.json" in result.output


def test_times_may_differ_and_nothing_else() -> None:
    data = {"seconds": 1.5, "stages": [{"search_seconds": 2, "nodes": 3}]}
    assert timeless(data) == {"stages": [{"nodes": 3}]}
