"""The tool's own logic; what it measures is never a test."""

import measure_ranks
import pytest
from click.testing import CliRunner


@pytest.mark.hostile
def test_ranks_are_started_and_come_to_the_same() -> None:
    options = ["--ranks", "1", "--ranks", "2", "--population", "31", "--repeats", "1"]
    result = CliRunner().invoke(measure_ranks.command, options)
    assert result.exit_code == 0, result.output
    assert [line[:7] for line in result.output.splitlines()] == ["1 ranks", "2 ranks"]


def test_a_difference_is_told(monkeypatch) -> None:
    def measured(count: int, population: int, repeats: int) -> dict[str, object]:
        return {"seconds": [1.0], "transitions": 10, "fitness": str(count)}

    monkeypatch.setattr(measure_ranks, "measured", measured)
    result = CliRunner().invoke(measure_ranks.command, [])
    assert result.exit_code == 1
    assert "different fitness" in result.output
