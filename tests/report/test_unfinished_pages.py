"""Pages of runs that are not finished, were thinned out, or are damaged."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from lxml import html
from report_pages import REFERENCE, change_rows, changed, parsed, thinned, words
from scipy.stats import binomtest

from cgtorch.ground.asked import NAMES
from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.report.page import report_page
from cgtorch.runs.journal import FileJournal
from cgtorch.runs.log import LOG, read_log
from cgtorch.runs.stored_run import read_run


def missing(page: html.HtmlElement) -> list[str]:
    found = page.xpath("//aside//li")
    return [words(line) for line in found]


def test_a_run_that_has_just_begun(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(REFERENCE / "robot", folder / "robot")
    shutil.copy(REFERENCE / "run.json", folder)
    page = parsed(folder)
    assert missing(page) == [
        "No stage is finished yet, so there is no skill to show.",
        "The log has no generations, so the page has no plots of the evolution.",
        "The log has nothing of Γ and C, so the page has no model reports.",
    ]
    ours = [words(e) for e in page.find_class("ours")]
    assert ours == [*["This run Not made in this run."] * 4, "This run Not tried yet."]
    assert [words(e) for e in page.find_class("paper")][3].startswith("The paper 3 of 5 reached")
    assert page.find(".//*[@id='results']") is None
    assert len(page.find_class("schematic")) == 4 == len(list(page.iter("svg")))
    text = words(page.get_element_by_id("reproduce"))
    assert "cgtorch-train --stage S0 --seed" in text
    assert "cgtorch-evaluate" not in text


def test_a_run_in_the_middle(tmp_path: Path) -> None:
    """Two stages are there, the third has begun, and the log knows more than is finished."""
    folder = thinned(tmp_path / "run", "S0", "S1")
    FileJournal(folder / "journal" / "S2").record("x", {"generations": torch.tensor(7)})
    FileJournal(folder / "journal" / "S1").record("x", {"generations": torch.tensor(9)})
    FileJournal(folder / "journal" / "S3").record("x", {"generations": torch.tensor(1)})
    (folder / "journal" / "a note").write_text("which is nobody's journal")
    page = parsed(folder)
    assert missing(page) == [
        "Finished stages: S0, S1. Not finished: S2, S3.",
        "S2 has begun and is not finished; its journal knows 7 generations.",
        "S3 has begun and is not finished; its journal knows 1 generation.",
    ]
    assert [words(e.find("h3")) for e in page.iter("article")] == [
        "S0: near", "S1: left", "S2: right", "S3: far",
    ]  # fmt: skip
    assert [len(list(e.iter("svg"))) for e in page.iter("article")] == [3, 3, 1, 1]
    done = sum(result["generations"] for result in read_run(folder).results)
    logged = words(page.get_element_by_id("evolution")).split("over the ")[1]
    assert int(logged.split()[0]) > done
    assert "cgtorch-train --stage S1 --seed" in words(page.get_element_by_id("reproduce"))


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("S1", []),
        ("S2", ["Finished stages: S0, S1. Not finished: S2."]),
        ("auto", []),
        (["S1"], ["Finished stages: S0, S1. Not finished: S2, S3."]),
    ],
)
def test_only_stages_that_were_asked_for_are_missing(
    tmp_path: Path, asked: object, said: list[str]
) -> None:
    folder = thinned(tmp_path / "run", "S0", "S1")
    changed(folder / "run.json", goes_on_to={"stage": asked})
    assert missing(parsed(folder)) == said


@pytest.mark.usefixtures("without_pictures")
def test_a_search_that_an_interruption_divided_took_longer_than_what_came_after(
    tmp_path: Path,
) -> None:
    folder = thinned(tmp_path / "run", "S0")
    change_rows(folder, "result", seconds=2.0, search_seconds=75.0)
    assert "0:02 since the run was last continued; search 1:15 in all" in words(parsed(folder))
    change_rows(folder, "result", seconds=80.0, search_seconds=75.0)
    assert "1:20, of which search 1:15" in words(parsed(folder))


@pytest.mark.usefixtures("without_pictures")
def test_a_run_without_models_and_events(tmp_path: Path) -> None:
    page = parsed(thinned(tmp_path / "run", "S0", models=False, generations=False))
    assert missing(page)[1:] == [
        "The log has no generations, so the page has no plots of the evolution.",
        "The log has nothing of Γ and C, so the page has no model reports.",
    ]
    assert "No generation is in the run" in words(page.get_element_by_id("evolution"))
    assert "Nothing is known of the models." in words(page.get_element_by_id("models"))


def test_a_run_json_that_is_no_object_by_now_is_named(tmp_path: Path) -> None:
    run = read_run(thinned(tmp_path / "run", "S0", generations=False))
    (run.folder / "run.json").write_text("[]")
    with pytest.raises(RunError, match=r"run\.json' holds no object; restore the file"):
        report_page(run)


@pytest.mark.usefixtures("without_pictures")
def test_shares_have_their_intervals_and_low_level_steps_their_columns(tmp_path: Path) -> None:
    folder = thinned(tmp_path / "run", "S0", models=False, generations=False)
    none = dict.fromkeys(NAMES, 0)
    asked = {"trials": none | {"motions": 7, "steps": 90, "simulated": 60}, "looks": none}
    test = {"scenarios": "left", "tried": 37, "succeeded": 29}
    change_rows(folder, "result", asked=asked, overall=test)
    page = parsed(folder)
    low, high = binomtest(29, 37).proportion_ci(0.95, "wilson")
    assert f"29 of 37 = 78.4% (95 %: {low:.1%} to {high:.1%}) on left" in words(page)
    (table,) = [e for e in page.iter("table") if "asked of the world" in words(e.find("caption"))]
    rows = [[words(cell) for cell in row.iter("th", "td")] for row in table.iter("tr")]
    assert rows[0][-2:] == ["low-level steps", "of them simulated"]
    assert rows[1] == ["trials", "7", "0", "0", "0", "90", "60"]
    assert rows[-1] == ["all", "7", "0", "0", "0", "90", "60"]


@pytest.mark.usefixtures("without_pictures")
def test_a_world_that_counts_nothing_has_no_table_of_it(tmp_path: Path) -> None:
    folder = thinned(tmp_path / "run", "S0", models=False, generations=False)
    change_rows(folder, "result", asked={})
    assert "What was asked" not in words(parsed(folder))


def test_half_a_log(tmp_path: Path) -> None:
    """As after a power cut; what is whole is drawn."""
    path = thinned(tmp_path / "run", "S0") / LOG
    path.write_bytes(path.read_bytes()[:-9])
    (svg,) = parsed(path.parent).xpath(
        "//section[@id='evolution']//svg[starts-with(@aria-label, 'Fit')]"
    )
    assert len(list(svg.iter("path"))) > 5


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    "values",
    [
        {"fresh": {"scenarios": "near", "tried": 4, "succeeded": 5}},
        {"seconds": -1},
        {"scenarios": 7},
        {"asked": {"trials": {"motions": 1}}},
    ],
)
def test_damaged_results_are_named(tmp_path: Path, values: dict[str, Any]) -> None:
    folder = thinned(tmp_path / "run", "S0", generations=False)
    change_rows(folder, "result", **values)
    with pytest.raises(RunError, match=rf"{next(iter(values))} in line \d+ of "):
        report_page(read_run(folder))


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    ("file", "values"),
    [
        ("S0/scenarios.json", {"W": [{}]}),
        ("S0/skill.json", {"start": "nobody"}),
        ("run.json", {"settings": {}}),
        ("robot/robot.json", {"footprint": "wide"}),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, file: str, values: dict[str, Any]) -> None:
    folder = thinned(tmp_path / "run", "S0", generations=False)
    changed(folder / file, **values)
    with pytest.raises(CgtorchError):
        report_page(read_run(folder))


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    ("model", "values"),
    [
        ("gamma", {"error": ["<b>"] * 7}),
        ("gamma", {"error": [0.1]}),
        ("gamma", {"coordinates": 7}),
        ("gamma", {"rows": "many"}),
        ("gamma", {"choice": [{"C": "x", "gamma": 1, "epsilon": 1, "score": 0}]}),
        ("gamma", {"learning_curve": {"sizes": [1], "train_scores": [[]], "test_scores": [[1]]}}),
        ("gamma", {"learning_curve": {"sizes": [1], "train_scores": 1, "test_scores": 2}}),
        ("gamma", {"learning_curve": 5}),
        ("classifier", {"balanced_accuracy": None}),
        ("classifier", {"reliability": [[0.5, 2.0, 4]]}),
        ("classifier", {"reliability": [["a", 0.5, 4]]}),
        ("classifier", {"reliability": 3}),
    ],
)
def test_damaged_reports_of_models(tmp_path: Path, model: str, values: dict[str, Any]) -> None:
    folder = thinned(tmp_path / "run", "S0", generations=False)
    report = read_log(folder)[1][model]
    change_rows(folder, "models", **{model: report | values})
    with pytest.raises(RunError, match=r"log\.jsonl"):
        report_page(read_run(folder))
