"""The film on a run's page: of the last scenario that the last skill has solved."""

from typing import Any

import numpy as np
import pytest
import torch
from lxml import html
from report_pages import thinned, words

from cgtorch.domains.film import Film
from cgtorch.ground.errors import SettingsError
from cgtorch.report import page as page_module
from cgtorch.report.page import report_page
from cgtorch.runs.storage import load_scenarios
from cgtorch.runs.stored_run import StoredRun, read_run

pytest.importorskip("PIL")
pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    folder = tmp_path_factory.mktemp("film") / "run"
    return read_run(thinned(folder, "S0", models=False, generations=False))


def filming(monkeypatch: pytest.MonkeyPatch, run: StoredRun, film: Any) -> list[Any]:
    """Have films drawn by a function; returns the list that will hold what they are of."""
    asked: list[Any] = []

    def drawn(self: Any, skill: Any, scenario: Any, width: int) -> Film:
        asked.append((skill.name, scenario, width))
        made: Film = film()
        return made

    monkeypatch.setattr(type(run.pictures), "film", drawn)
    return asked


def page_of(run: StoredRun) -> html.HtmlElement:
    return html.document_fromstring(report_page(run).decode())


def black() -> Film:
    return Film([np.full((4, 6, 3), 9 * i, np.uint8) for i in range(2)], 50, "success")


def test_the_last_scenario_that_was_solved_is_filmed(
    monkeypatch: pytest.MonkeyPatch, run: StoredRun
) -> None:
    asked = filming(monkeypatch, run, black)
    page = page_of(run)
    ((name, scenario, width),) = asked
    solved, _ = load_scenarios(run.folder / "S0" / "scenarios.json", run.like())
    assert (name, len(scenario), width) == ("S0", 1, page_module.FILMED)
    for one, other in zip(vars(scenario).values(), vars(solved[-1:]).values(), strict=True):
        assert torch.equal(one, other)
    (film,) = page.iter("img")
    assert film.get("src").startswith("data:image/webp;base64,UklGR"), "which is RIFF"
    assert "img-src data:" in page.xpath("//meta/@content")[0]
    assert "There is no film" not in words(page)


def test_it_is_said_why_there_is_none(monkeypatch: pytest.MonkeyPatch, run: StoredRun) -> None:
    def fails() -> Film:
        raise SettingsError("nothing draws here")

    filming(monkeypatch, run, fails)
    page = page_of(run)
    assert "There is no film of S0: nothing draws here." in words(page)
    assert not [*page.iter("img")]
    filming(monkeypatch, run, black)
    monkeypatch.setattr(page_module, "MOST_FILMED", 50)
    page = page_of(run)
    assert "The film of S0 is too large for a page; cgtorch-view makes it." in words(page)
    assert not [*page.iter("img")]
