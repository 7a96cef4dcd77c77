"""What the tool that trains for Gymnasium environments runs and tells."""

from pathlib import Path
from typing import Any

import measure_gymnasium as tool
import pytest
from click.testing import CliRunner
from measure_gymnasium import LEARNED, TASKS, Counts, summary, table

from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.files import write_json


def row(seed: int, solved: bool, interaction: int) -> dict[str, Any]:
    return {
        "environment": "Pendulum-v1", "seed": seed, "mean_return": -150.0 - seed, "solved": solved,
        "rounds": 1, "interaction": interaction, "episodes": 3, "steps": 700, "cpu_seconds": 1.0,
        "seconds": 2.0,
    }  # fmt: skip


def test_the_summary_has_medians_and_the_number_of_solved_seeds() -> None:
    rows = [row(0, True, 300), row(1, False, 900), row(2, True, 500)]
    assert summary(rows).splitlines()[-1] == (
        "| Pendulum-v1 | 2 of 3 | -151.0 | 500 | 3 | 700 | 1.0 |"
    )
    assert "| Pendulum-v1 | 1 | -151.0 | no | 1 | 900 | 3 | 700 | 1.0 | 2.0 |" in table(rows)


def test_a_search_ends_with_its_last_step_and_a_test_goes_on() -> None:
    searching, testing = Counts(most=3), Counts(most=3, testing=True)
    for counts in (searching, testing):
        counts.add(2, 1)
        assert not counts.over
    with pytest.raises(BudgetSpentError, match="all 3 steps"):
        searching.add(1, 0)
    testing.add(1, 0)
    for counts in (searching, testing):
        counts.add(5, 5)  # which are not counted
        assert (counts.over, counts.steps, counts.episodes) == (True, 3, 1)


@pytest.mark.parametrize("models", ["none", "learned"])
def test_models_choose_what_is_trained(
    models: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A training is put in the place of the command's, which only writes what it would."""
    run, wanted = tmp_path / "Pendulum-v1-3", list[list[str]]()
    asked = {"starts": {"motions": 5}, "champions": {"motions": 7}}

    def counted(training: Any, most: int | None) -> dict[str, float]:
        wanted.append(training.args[0])
        run.mkdir()
        write_json(run / "gymnasium.json", {"target_return": -200.0})
        return {"episodes": 1, "steps": 2, "cpu_seconds": 0.0, "seconds": 0.0}

    def ends(run: Path, event: str) -> list[dict[str, Any]]:
        return [{"asked": asked}] if event == "result" else []

    monkeypatch.setattr(tool, "counted", counted)
    monkeypatch.setattr(tool, "_tried", lambda run: {"mean_return": -100.0})
    monkeypatch.setattr(tool, "_ends", ends)
    found = tool.measured(tmp_path, models, 3, 1.5, None, "Pendulum-v1", 3)
    (words,) = wanted
    assert words[words.index("--models") + 1] == models
    assert words[words.index("--target") + 1] == "-200"
    assert (found["interaction"], found["solved"], found["rounds"]) == (12, True, 1)


def test_environments_without_learned_models_are_named(tmp_path: Path) -> None:
    words = [str(tmp_path), "--models", "learned", "--only", "Acrobot-v1"]
    found = CliRunner().invoke(tool.command, words)
    assert found.exit_code == 2
    assert "Acrobot-v1 is not among those of learned models" in found.output
    assert set(LEARNED) - set(TASKS) == {"examples.swing_up:CartPoleSwingUp-v0"}
