import io
import re

import pytest
from reaching import TABLE
from report_pages import final_text
from rich.console import Console

from cgtorch.report import final_table


def result(stage: str, kind: str, succeeded: int, **changes: object) -> dict[str, object]:
    return {
        "stage": stage,
        "scenarios": kind,
        "targets_succeeded": succeeded,
        "targets": 5,
        "w_size": 65,
        "w_lost": 0,
        "nodes": 7,
        "depth": 2,
        "generations": 1140,
        "seconds": 379.6,
        "fresh": {"scenarios": kind, "tried": 40, "succeeded": 38},
        "overall": None,
        **changes,
    }


RESULTS = [
    result("S0", "near", 5, w_size=0, depth=1, seconds=9.6),
    result("S1", "left", 5, overall={"tried": 40, "succeeded": 12}),
    result("S2", "right", 5, w_lost=2),
    result("S3", "far", 4, overall={"tried": 40, "succeeded": 39}),
]


def shown(results: list[dict[str, object]], width: int) -> str:
    screen = Console(file=io.StringIO(), width=width)
    screen.print(final_table(results, TABLE))
    assert isinstance(screen.file, io.StringIO)
    return screen.file.getvalue()


def test_text_puts_ours_beside_the_papers() -> None:
    lines = [
        re.split(r"\s{2,}", line.strip()) for line in final_text(RESULTS, TABLE).splitlines()[1:]
    ]
    assert lines == [
        ["stage", "scenarios", "ours", "the paper", "W kept", "fresh", "nodes", "gens",
         "time"],
        ["S0", "near", "5/5", "5/5", "0/0", "38/40", "7", "1140", "0:10"],
        ["S1", "left", "5/5", "5/5", "65/65", "38/40", "7", "1140", "6:20"],
        ["S2", "right", "5/5", "4/5", "63/65", "38/40", "7", "1140", "6:20"],
        ["S3", "far", "4/5", "3/5", "65/65", "38/40", "7", "1140", "6:20"],
        ["S3 on perimeter: 39/40 = 97.5 %. The paper after S3: 34/40 = 85 %."],
    ]  # fmt: skip


def test_columns_are_aligned() -> None:
    lines = final_text(RESULTS, TABLE).splitlines()[1:]
    at = lines[0].index("the paper")
    assert all(line[at - 1] == " " and line[at] != " " for line in lines)
    assert len({len(line) for line in lines[:-1]}) == 1


def test_the_last_result_of_the_paper_is_not_taken_for_one_of_an_early_stage() -> None:
    early = result("S0", "near", 5, overall={"tried": 40, "succeeded": 30})
    last = final_text([early], TABLE).splitlines()[-1]
    assert last == "S0 on perimeter: 30/40 = 75 %. The paper after S3: 34/40 = 85 %."


@pytest.mark.parametrize("width", [80, 120])
def test_no_number_is_cut_in_a_terminal(width: int) -> None:
    text = shown(RESULTS, width)
    for row in final_text(RESULTS, TABLE).splitlines()[1:]:
        for word in row.split():
            assert word in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width


def test_other_placements_than_the_papers_are_not_beside_its_result() -> None:
    test = {"scenarios": "general", "tried": 40, "succeeded": 30}
    text = final_text([result("auto-1", "general", 5, overall=test)], TABLE)
    assert text.splitlines()[-1] == "auto-1 on general: 30/40 = 75 %."


def test_what_is_missing_is_a_dash() -> None:
    bare: list[dict[str, object]] = [{"stage": "S9", "overall": None, "fresh": None}]
    for text in (final_text(bare, TABLE), shown(bare, 100)):
        row = next(line for line in text.splitlines() if "S9" in line)
        assert row.split() == ["S9", *["–"] * 8]
        assert "34/40" not in text
    assert len(final_text([], TABLE).splitlines()) == 2


def test_a_round_without_a_test_on_fresh_scenarios_claims_nothing_about_them() -> None:
    """Where a world does not repeat itself, a skill is judged by practice, and not tested again."""
    practice = {"overall": None, "fresh": None, "in_a_row": 24, "practice": 24}
    tested = result("auto-1", "perimeter", 3, overall={"tried": 40, "succeeded": 12})
    lines = final_text([result("auto-1", "perimeter", 3, **practice)], TABLE).splitlines()
    assert lines[-1].split() == [
        "auto-1", "perimeter", "3/5", "–", "65/65", "–", "7", "1140", "6:20",
    ]  # fmt: skip
    both = [tested, result("auto-2", "perimeter", 3, **practice)]
    assert final_text(both, TABLE).splitlines()[-1].startswith("auto-1 on perimeter: 12/40 = 30 %")


def test_names_are_not_taken_for_markup() -> None:
    odd = [result("[red]S1[/]", "left", 5)]
    assert "[red]S1[/]" in shown(odd, 120)
