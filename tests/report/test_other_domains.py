"""Reports of a domain that gives rewards, has no pictures, and of which nobody has published."""

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from lxml import html
from report_pages import final_text, words
from support import create_run
from told_by_runs import logged

from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.report.messages import mean_text
from cgtorch.report.page import report_page
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training
from cgtorch.training.train import train


def trained(folder: Path, domain: str, make: Callable[[Training], object]) -> StoredRun:
    """A small run, really trained."""
    settings = RunSettings(
        domain=domain, seed=2, population=40, generations=8, attempts=2, practice=12
    )
    run = create_run(folder, settings)
    make(Training(run, lambda event: None, lambda message: nullcontext()))
    return run


def page_of(run: StoredRun) -> html.HtmlElement:
    page = report_page(read_run(run.folder, domain=run.settings.domain))
    return html.document_fromstring(page.decode())


@pytest.fixture(scope="module")
def rounds(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    folder = tmp_path_factory.mktemp("rounds") / "walks"
    return trained(folder, "walking:Walking", lambda t: train_until(t, Goal(rounds=1)))


@pytest.fixture(scope="module")
def page(rounds: StoredRun) -> html.HtmlElement:
    return page_of(rounds)


@pytest.fixture(scope="module")
def result(rounds: StoredRun) -> dict[str, Any]:
    return rounds.results[0]


def test_nobody_else_is_beside_the_run(page: html.HtmlElement, result: dict[str, Any]) -> None:
    head, row = ([words(c) for c in line.iter("th", "td")] for line in
                 page.get_element_by_id("results").find(".//table").iter("tr"))  # fmt: skip
    assert head[:6] == ["stage", "on", "solved", "W kept", "fresh", "overall"]
    assert len(head) == len(row)
    assert row[:2] == ["auto-1", "any"]
    assert page.find_class("paper") == []
    assert "beside" not in page.xpath("//section[@id='stages']//div/@class")
    assert "overall" not in page.xpath("//@id")
    said = " ".join(words(page.get_element_by_id(name)) for name in ("results", "stages"))
    assert "published" not in said
    assert f"is the mean return of {result['fresh']['tried']} fresh episodes" in said


def test_what_cannot_be_drawn_is_said(page: html.HtmlElement, rounds: StoredRun) -> None:
    stage = page.get_element_by_id("stage-1")
    known = json.loads((rounds.folder / "auto-1" / "scenarios.json").read_text())
    assert (known["W"], known["M"]) == ([], [])  # as the mean on fresh scenarios counts
    assert "no scenarios are kept, as fresh episodes decide" in words(stage)
    labels = stage.xpath(".//svg/@aria-label")
    assert len(labels) == 1
    assert labels[0].startswith("Graph of auto-1: ")


def test_returns_are_told(page: html.HtmlElement, result: dict[str, Any]) -> None:
    cards = {words(e.find("dt")): words(e.find("dd")) for e in page.find_class("cards")[0]}
    mean = result["overall"]["mean_return"]
    assert cards["Mean return"] == f"{mean:.5g} of fresh episodes"
    facts = words(page.get_element_by_id("stage-1"))
    assert f"mean return {result['fresh']['mean_return']:.5g}" in facts


def test_what_does_not_count_where_means_do_is_left_out(page: html.HtmlElement) -> None:
    """Nothing is kept in W and M, and the world counts nothing."""
    said = words(page.find(".//body"))
    assert "judged by the mean of fresh episodes" in said
    assert "is the mean return of" in words(page.get_element_by_id("stage-1"))
    for other in ("Forgotten", "accepted only if", "(eq. 1a)", "(eq. 1b)", "What was asked of"):
        assert other not in said


def test_it_was_searched_in_the_world(page: html.HtmlElement) -> None:
    assert "searched in the world itself" in words(page.find(".//header"))
    assert "Actions tried in the world" in words(page.get_element_by_id("stage-1"))
    assert "models" not in page.xpath("//@id")
    assert "nothing of Γ and C" not in words(page)


def test_the_course_is_one_of_returns(page: html.HtmlElement, rounds: StoredRun) -> None:
    """What an unfinished episode is worth is on no axis."""
    evolution = page.get_element_by_id("evolution")
    said = [words(text) for text in evolution.iter("text")]
    assert "mean return" in said
    assert "fitness (eq. 3)" not in said
    assert "no return" in " ".join(said)
    rows = logged(rounds.folder, "generation")
    values = [
        row[name] for row in rows for name in ("best", "mean", "low") if row[name] is not None
    ]
    assert WORTHLESS < min(values) < 0
    assert any(0 < row["unsolved"] < 1 for row in rows)
    assert "1e" not in " ".join(said)


def test_the_commands_name_the_domain(page: html.HtmlElement) -> None:
    text = words(page.get_element_by_id("reproduce"))
    assert "--domain walking:Walking" in text.split("runs/again")[0]
    assert text.count("--domain walking:Walking") >= 3
    assert "gymnasium" not in text


def test_the_final_table_has_no_column_for_others(
    rounds: StoredRun, result: dict[str, Any]
) -> None:
    title, head, *_, last = final_text([result], rounds.domain).splitlines()
    assert title == "Scenarios solved"
    assert head.split() == [
        "stage", "scenarios", "solved", "W", "kept", "fresh", "nodes", "gens", "time",
    ]  # fmt: skip
    overall = result["overall"]
    assert f"mean return {mean_text(overall['mean_return'], overall['error'])}" in last


def test_a_stage_without_tests_has_a_drawing_and_tells_of_fresh_scenarios(tmp_path: Path) -> None:
    run = trained(tmp_path / "run", "walking:StagedWalking", lambda t: train(t, "first"))
    page = page_of(run)
    stage = page.get_element_by_id("stage-1")
    assert words(stage.find("h3")) == "first: short"
    assert len(stage.find_class("stage-drawing")) == 1
    result = run.results[0]
    assert result["targets"] == 0
    fresh = f"{result['fresh']['succeeded']} of {result['fresh']['tried']} fresh ones solved"
    assert words(stage.find_class("score")[0]) == fresh
    lines = final_text([result], run.domain).splitlines()
    assert lines[2].split()[:3] == ["first", "short", "–"]


@pytest.mark.parametrize(
    ("mean", "error", "text"),
    [
        (2.857, 0.01, "2.86 ± 0.02"),
        (-3.5, 0.0, "-3.5 ± 0"),
        (1.884e-11, 1e-13, "1.88e-11 ± 2e-13"),
        (-3e-12, 2e-12, "-3e-12 ± 4e-12"),
        (1.88e31, 2e29, "1.88e+31 ± 4e+29"),
        (0.0, 1e-12, "0.000000 ± 0.000000"),
        (2.5, None, "2.5"),
    ],
)
def test_a_mean_has_its_digits_in_any_unit(mean: float, error: float | None, text: str) -> None:
    assert mean_text(mean, error) == text
