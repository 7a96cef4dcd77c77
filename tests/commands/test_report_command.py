"""`cgtorch-report`: a page of a run, finished or not; bad input."""

from pathlib import Path

import pytest
from command_line import REPORT, Shell, listing
from lxml import html
from report_pages import REFERENCE, thinned, words
from trained import Trained, interrupted

from cgtorch.report.page import report_page
from cgtorch.runs.journal import recalled_generations
from cgtorch.runs.stored_run import read_run
from cgtorch.training.explained import explained


def test_one_file_is_written_and_replaced_only_when_asked(shell: Shell, tmp_path: Path) -> None:
    folder = thinned(tmp_path / "run", "S0", models=False, generations=False)
    before, page = listing(tmp_path), tmp_path / "page.html"
    command = (REPORT, "run", "--output", "page.html")
    page.write_text("precious")
    assert "'page.html' exists; choose another --output or add --force" in shell.refuses(*command)
    assert page.read_text() == "precious"
    ended = shell.does(*command, "--force")
    data = page.read_bytes()
    assert (ended.err, ended.out) == ("", f"run as a page: page.html, {len(data)} bytes\n")
    assert listing(tmp_path) == before | {"page.html"}
    run = read_run(folder)
    assert data == report_page(run, explained(run))


def test_a_run_that_was_interrupted(shell: Shell, tmp_path: Path, trained: Trained) -> None:
    """It has S0, and of S1 what the journal knows."""
    run = interrupted(trained, tmp_path / "run")
    known, before = recalled_generations(run.folder), listing(run.folder)
    assert known > 0
    shell.does(REPORT, "run", "--output", "page.html")
    assert listing(run.folder) == before
    page = html.document_fromstring((tmp_path / "page.html").read_text())
    said = [words(line) for line in page.xpath("//aside//li")]
    assert "Finished stages: S0. Not finished: S1, S2, S3." in said
    begun = f"S1 has begun and is not finished; its journal knows {known} "
    assert any(line.startswith(begun) for line in said)
    assert "These are the last ones." in words(page.get_element_by_id("models"))
    assert "of 40 near, " in words(page.get_element_by_id("failures"))


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("nowhere", "--output", "x"), "'nowhere' is no run (it has no run.json)"),
        ((REFERENCE / "S0", "--output", "x"), "is no run"),
        ((REFERENCE,), "Missing option '--output'"),
        (("--output", "x"), "Missing argument 'RUN'"),
        (("run", "--output", "no/where/x"), "'no/where' is no folder"),
        ((REFERENCE, "--output", "."), "is a folder; choose another --output"),
        ((REFERENCE, "--output", "x", "--actions", "Wait"), "was begun without action 'Wait'"),
    ],
)
def test_bad_input(shell: Shell, tmp_path: Path, words: tuple[object, ...], line: str) -> None:
    if words[0] == "run":
        thinned(tmp_path / "run", "S0", models=False, generations=False)
    before = listing(tmp_path)
    assert line in shell.refuses(REPORT, *words)
    assert listing(tmp_path) == before
