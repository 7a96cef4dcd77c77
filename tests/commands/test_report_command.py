"""`cgtorch-report`: a page of a run, finished or not; bad input."""

import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Shell, in_a_shell, listing
from lxml import html
from report_pages import REFERENCE, thinned, words
from trained import Trained, interrupted

from cgtorch.report.page import report_page
from cgtorch.runs.journal import recalled_generations
from cgtorch.runs.stored_run import read_run

REPORT = "cgtorch-report"


def test_help_has_examples() -> None:
    ended = in_a_shell(REPORT, "--help")
    assert (ended.code, ended.err) == (0, "")
    assert "cgtorch-report runs/reference --output report.html" in ended.out


def test_help_does_not_wait_for_torch() -> None:
    code = "import sys, cgtorch.commands.report as c; print({'torch', 'jinja2'} & set(sys.modules))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout == "set()\n"


def test_one_file_is_written(shell: Shell, tmp_path: Path) -> None:
    folder = thinned(tmp_path / "run", "S0")
    before = listing(tmp_path)
    ended = shell(REPORT, "run", "--output", "page.html")
    data = (tmp_path / "page.html").read_bytes()
    assert (ended.code, ended.err) == (0, "")
    assert ended.out == f"run as a page: page.html, {len(data)} bytes\n"
    assert listing(tmp_path) == before | {"page.html"}
    assert data == report_page(read_run(folder))


def test_a_run_that_was_interrupted(shell: Shell, tmp_path: Path, trained: Trained) -> None:
    """It has S0, and of S1 what the journal knows."""
    run = interrupted(trained, tmp_path / "run")
    known = recalled_generations(run.folder)
    assert known > 0
    before = listing(run.folder)
    assert shell(REPORT, "run", "--output", "page.html").code == 0
    assert listing(run.folder) == before
    page = html.document_fromstring((tmp_path / "page.html").read_text())
    said = [words(line) for line in page.xpath("//aside//li")]
    assert "Finished stages: S0. Not finished: S1, S2, S3." in said
    assert any(line.startswith(f"S1 has begun and is not finished; its journal knows {known} ")
               for line in said)  # fmt: skip
    assert (
        words(page.get_element_by_id("models")).count("These are the last ones.") == 1
    )


def test_a_file_is_replaced_only_when_asked(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "mine.html").write_text("precious")
    thinned(tmp_path / "run", "S0", models=False, generations=False)
    words = (REPORT, "run", "--output", "mine.html")
    assert "'mine.html' exists; choose another --output or add --force" in shell.refuses(*words)
    assert (tmp_path / "mine.html").read_text() == "precious"
    assert shell(*words, "--force").code == 0
    assert (tmp_path / "mine.html").read_text().startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("nowhere", "--output", "x"), "'nowhere' is no run (it has no run.json)"),
        ((REFERENCE / "S0", "--output", "x"), "is no run"),
        ((REFERENCE,), "Missing option '--output'"),
        (("--output", "x"), "Missing argument 'RUN'"),
        ((REFERENCE, "--output", "no/where/x"), "where"),
        ((REFERENCE, "--output", "."), "is a folder; choose another --output"),
        ((REFERENCE, "--output", "x", "--actions", "Wait"), "was begun without action 'Wait'"),
    ],
)
def test_bad_input(shell: Shell, tmp_path: Path, words: tuple[object, ...], line: str) -> None:
    assert line in shell.refuses(REPORT, *words)
    assert listing(tmp_path) == set()
