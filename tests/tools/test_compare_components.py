"""The table of what parts of the search are worth, from results that are kept."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import compare_components
from click.testing import CliRunner
from standard.measure import Result


def result(library: str, seed: int, evaluations: int, *, solved: bool = True) -> Result:
    return Result("cartpole", library, seed, solved, evaluations, 4, 100, 1.0, None, 500.0)


OURS = [result("cgtorch", seed, 100 + seed) for seed in range(6)]
SLOWER = [result("one lineage", seed, 200 + 10 * seed) for seed in range(6)]


def cells(results: list[Result]) -> dict[str, str]:
    columns, rows = compare_components.table(results)
    assert columns == ["search", "CartPole"]
    return {row[0]: row[1] for row in rows}


def test_a_variant_is_compared_seed_by_seed() -> None:
    """All of six differences have the same sign, which has a chance of 2 in 64."""
    elsewhere = replace(OURS[0], task="acrobot")
    both = [result(name, 9, 7, solved=False) for name in ("cgtorch", "one lineage")]
    failed = [result("mutation alone", seed, 50, solved=seed == 0) for seed in range(6)]
    found = cells([*SLOWER, *OURS, elsewhere, *failed])
    assert found == {
        "cgtorch": "6 of 6, 102",
        "one lineage": "6 of 6, 225, p 0.031",
        "mutation alone": "1 of 6, –, p 0.062",
    }
    assert next(iter(found)) == "cgtorch"
    assert cells([*OURS, *SLOWER, *both])["one lineage"].endswith("p 0.031")


def test_the_command_writes_a_figure(tmp_path: Path) -> None:
    kept, figure = tmp_path / "kept.json", tmp_path / "figure.json"
    kept.write_text(json.dumps({"results": [asdict(each) for each in OURS + SLOWER]}))
    figure.write_text('{"title": "Parts", "rows": []}')
    words = [str(kept), "--figure", str(figure)]
    ran = CliRunner().invoke(compare_components.command, words, catch_exceptions=False)
    written = json.loads(figure.read_text())
    assert written["title"] == "Parts"
    assert written["columns"] == ["search", "CartPole"]
    assert "| one lineage | 6 of 6, 225, p 0.031 |" in ran.stdout
    assert written["rows"][1] == ["one lineage", "6 of 6, 225, p 0.031"]
