"""A run goes on after one of its ranks was killed; the tool itself kills many."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from kill_and_resume import results_of
from kill_rank import command


@pytest.mark.hostile
def test_a_run_whose_rank_was_killed_ends_as_one_process(tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(tmp_path), "--kills", "1", "--stage", "S0"])
    assert result.exit_code == 0, result.output
    assert "the same; 1 of 1" in result.output
    found = results_of(tmp_path / "killed-0")
    assert {"S0/skill.json", "S0/scenarios.json", "start/data.safetensors"} <= set(found)
    assert found["log.jsonl"]
    assert not list(tmp_path.glob("*/journal/S0"))
