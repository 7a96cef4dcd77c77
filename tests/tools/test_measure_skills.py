"""One small run, measured; and the table."""

from pathlib import Path

import measure_skills
from click.testing import CliRunner

from cgtorch.ground.files import read_json

HASTY = "--transitions 200 --attempts 8 --population 100 --generations 15 --practice 4 --rounds 1"


def test_a_run_is_made_once_and_measured(tmp_path: Path) -> None:
    arguments = [str(tmp_path / "made"), "--seeds", "0:1", "--kinds", "auto", "--count", "40"]
    ended = CliRunner().invoke(measure_skills.command, [*arguments, "--options", HASTY])
    assert ended.exit_code == 0, ended.output
    result = read_json(tmp_path / "made" / "auto-0.json")
    assert result["tried"] == 40
    assert set(result["succeeded"]) == {"perimeter", "near", "left", "right", "far"}
    assert all(0 <= count <= 40 for count in result["succeeded"].values())
    assert result["w_lost"] == 0
    assert 0 < result["searching"] < result["improving"] < result["seconds"]
    table = (tmp_path / "made" / "table.md").read_text()
    assert table in ended.output
    assert f"| {result['succeeded']['perimeter'] / 40:.1%} |" in table
    run = next((tmp_path / "made" / "auto-0").glob("auto-1/skill.json"))
    before = run.stat().st_mtime_ns
    assert CliRunner().invoke(measure_skills.command, arguments).exit_code == 0
    assert run.stat().st_mtime_ns == before


def test_the_table_tells_the_median_and_the_least() -> None:
    results = [
        {"kind": "clutter", "tried": 10, "succeeded": {"general-clutter": n}}
        | {"seconds": 60.0 + n, "searching": 10.0 * n, "w_lost": n, "nodes": n, "largest": 2 * n}
        for n in (9, 7, 8)
    ]
    cells = [cell.strip() for cell in measure_skills.table(results).splitlines()[-1].split("|")]
    assert cells[2:-1] == ["general-clutter", "80.0%", "70.0%", "3", "68, 90", "24", "9, 18"]
    assert len(measure_skills.table([]).splitlines()) == 2
