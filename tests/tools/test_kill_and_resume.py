"""A training is killed until it has ended, and compared with one that was left alone.

`tests/examples` and `test_kill_rank.py` kill real trainings.
"""

from pathlib import Path

import click
import kill_and_resume
import pytest
from click.testing import CliRunner
from kill_and_resume import command, timeless, train


def test_a_training_ends_or_is_killed_after_its_time(tmp_path: Path) -> None:
    assert train(tmp_path, ["--help"])
    assert not train(tmp_path, [], 0.01)
    with pytest.raises(click.ClickException, match="exit code 2"):
        train(tmp_path, ["--stage"])


@pytest.mark.parametrize(("found", "code"), [(1, 0), (3, 1)])
def test_a_difference_is_told(
    found: int, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first training of each run is killed twice."""
    ends = iter([True, False, False, True])
    results = iter([{"S0/skill.json": 1, "x": 2}, {"S0/skill.json": found, "x": 2}])
    monkeypatch.setattr(kill_and_resume, "train", lambda *words: next(ends))
    monkeypatch.setattr(kill_and_resume, "results_of", lambda run: next(results))
    result = CliRunner().invoke(command, [str(tmp_path), "--kills", "2"])
    assert result.exit_code == code
    said = "differs in S0/skill.json" if code else "2 kills, the same; 2 of 2"
    assert said in result.output


def test_times_may_differ_and_nothing_else() -> None:
    data = {"seconds": 1.5, "stages": [{"search_seconds": 2, "nodes": 3}]}
    assert timeless(data) == {"stages": [{"nodes": 3}]}
