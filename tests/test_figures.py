"""Tables in pages are those of docs/figures. None contradicts another, stale ones are marked."""

import sys
from copy import deepcopy
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tools"))

import check_prose  # noqa: E402
import draw_architecture  # noqa: E402
import make_figures  # noqa: E402

FIGURES = make_figures.read_figures()
WRITE = "call `make figures`"


@pytest.mark.parametrize("page", make_figures.pages(), ids=lambda page: page.name)
def test_pages_hold_the_tables_of_the_figures(page: Path) -> None:
    """So a stale figure is marked, too: the mark is part of what is written."""
    text = page.read_text()
    assert text.count("<!-- figure:") == text.count("<!-- /figure -->")
    assert make_figures.with_figures(text, FIGURES) == text, WRITE


def test_every_figure_is_in_a_page() -> None:
    text = "".join(page.read_text() for page in make_figures.pages())
    assert {name for name in FIGURES if f"<!-- figure: {name} -->" not in text} == set()


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_says_how_it_came_about(name: str) -> None:
    figure = FIGURES[name]
    assert all(len(row) == len(figure["columns"]) for row in figure["rows"])
    if "origin" not in figure:
        assert all(figure[key] for key in ("command", "commit", "machine", "depends"))
        assert all((ROOT / folder).exists() for folder in figure["depends"])


def test_no_figure_contradicts_another() -> None:
    assert make_figures.contradictions(FIGURES) == []


def test_another_value_for_the_same_thing_is_a_contradiction() -> None:
    other = deepcopy(FIGURES["skills"])
    other["rows"][0][2] = "12.3 %"
    (line,) = make_figures.contradictions({**FIGURES, "other": other})
    assert "12.3 %" in line


def test_changed_code_makes_a_figure_stale() -> None:
    figure = {**FIGURES["stages"], "code": make_figures.code_hash(FIGURES["stages"]["depends"])}
    assert "**Stale:**" not in make_figures.origin(figure)
    assert "**Stale:**" in make_figures.origin({**figure, "code": "0"})


def test_comments_and_docstrings_are_no_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(make_figures, "ROOT", tmp_path)
    (tmp_path / "a").mkdir()
    file, hashes = tmp_path / "a" / "b.py", []
    for text in ('"""One."""\nx = 1\n', '"""Two."""\nx = 1  # one\n', "x = 2\n"):
        file.write_text(text)
        hashes.append(make_figures.code_hash(["a"]))
    assert hashes[0] == hashes[1] != hashes[2]


def test_plots_are_those_of_the_figures() -> None:
    for name, svg in make_figures.plots(FIGURES).items():
        assert (ROOT / make_figures.PLOTS / name).read_text() == svg, WRITE


def test_the_drawing_of_the_architecture_is_that_of_the_imports() -> None:
    drawn = draw_architecture.drawing(draw_architecture.imports())
    assert draw_architecture.OUTPUT.read_text() == drawn, WRITE


def test_the_prose_keeps_to_the_style() -> None:
    found = [*check_prose.in_pages(), *check_prose.in_docstrings(), *check_prose.in_helps()]
    assert found == []


@pytest.mark.parametrize(
    "text", ["What is not Γ, C or networks in generations 1.", "word " * 46, "The house has rooms."]
)
def test_what_breaks_the_style_is_found(text: str) -> None:
    assert [*check_prose.in_prose("here", text, check_prose.LONGEST)]
