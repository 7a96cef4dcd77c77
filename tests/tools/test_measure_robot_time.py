"""What a skill costs a robot is counted up to what had been asked before it acted."""

import json
from pathlib import Path
from typing import Any

import measure_robot_time as tool
import pytest
from click.testing import CliRunner

from cgtorch.runs.settings import RunSettings
from cgtorch.tabletop.settings import TabletopSettings

ROWS: list[dict[str, Any]] = [
    {"course": [[20, 0.5], [40, 0.86], [70, 0.83], [90, 1.0]]},
    {"course": [[30, 0.9], [50, 0.885]]},
    {"course": [[10, 0.2]]},
]


def test_a_share_is_passed_when_a_skill_first_has_it() -> None:
    assert [tool.passed(row, 0.85) for row in ROWS] == [40, 30, float("inf")]
    assert tool.worse(ROWS) == (1, 4)


@pytest.mark.hostile
def test_a_small_run_is_measured(tmp_path: Path) -> None:
    """Its skills are tried on fresh placements, which are not counted."""
    settings = RunSettings(seed=3, population=40, generations=10, attempts=2, practice=2)
    own = TabletopSettings(noise="fresh")
    row = tool.measured(tmp_path / "run", settings, own, 20, stages=False)
    counted = sum(phase["motions"] + phase["tests"] for phase in row["phases"].values())
    assert counted == row["motions"] + row["tests"]
    asked, shares = zip(*row["course"], strict=True)
    assert list(asked) == sorted(asked)
    exploration = row["phases"]["exploration"]
    assert asked[0] >= exploration["motions"] + exploration["tests"]
    assert asked[-1] < counted
    assert all((20 * share).is_integer() for share in shares)
    assert row["success"] == shares[-1]
    (tmp_path / "seed-3.json").write_text(json.dumps(row))
    found = CliRunner().invoke(tool.main, [str(tmp_path), "--seeds", "3:4"])
    assert found.exit_code == 0, found.output
    assert f"| world actions, median (most) | {counted} ({counted}) |" in found.output
    assert (tmp_path / "robot-time.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_one_seed_makes_a_table(share: float) -> None:
    row = {"course": [[9, share]], "success": share, "motions": 5, "tests": 4, "looks": 3}
    table = tool.table_of([row | {"seconds": 1.0}])
    assert f"| success, median (least) | {100 * share:.1f} % ({100 * share:.1f}) |" in table
    assert "| skills replaced by a worse one | 0 of 0 |" in table
