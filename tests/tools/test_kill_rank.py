"""A run goes on after one of its ranks was killed; the tool itself kills many."""

from pathlib import Path

from click.testing import CliRunner
from kill_rank import command


def test_a_run_whose_rank_was_killed_ends_as_one_process(tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(tmp_path), "--kills", "1", "--stage", "S0"])
    assert result.exit_code == 0, result.output
    assert "the same; 1 of 1" in result.output
    assert (tmp_path / "killed-0" / "S0" / "skill.json").is_file()
