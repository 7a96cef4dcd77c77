"""A small stage, told by the events of a real evolution, and the page of the reference run."""

from pathlib import Path

import pytest
from lxml import html
from made_once import made_once, shared_folder
from markupsafe import Markup
from report_pages import REFERENCE
from told_stage import Told, make_stage, told_stage

from cgtorch.domains.knowledge import Knowledge
from cgtorch.improvement.events import Event
from cgtorch.report.page import report_page
from cgtorch.runs.stored_run import read_run


@pytest.fixture(scope="session")
def told(tmp_path_factory: pytest.TempPathFactory) -> Told:
    """A small stage, made once."""
    return told_stage(made_once(shared_folder(tmp_path_factory) / "told_stage", make_stage))


@pytest.fixture(scope="session")
def knowledge(told: Told) -> Knowledge:
    """The models that the events tell of."""
    return told.knowledge


@pytest.fixture(scope="session")
def events(told: Told) -> list[Event]:
    """Two candidates of stage S1, the models between them, and the skill made of both."""
    return told.events


@pytest.fixture(scope="session")
def page_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The page of the reference run as it is written, made once."""
    page = shared_folder(tmp_path_factory) / "page.html"
    return made_once(page, _write).read_bytes()


def _write(page: Path) -> None:
    page.write_bytes(report_page(read_run(REFERENCE)))


@pytest.fixture(scope="session")
def page(page_bytes: bytes) -> html.HtmlElement:
    """The page as a tree."""
    return html.document_fromstring(page_bytes.decode())


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages are made of words alone, which takes a tenth of the time."""
    for place in ("page", "sections"):
        monkeypatch.setattr(f"cgtorch.report.{place}.inline_svg", lambda *about: Markup(""))
    monkeypatch.setattr("cgtorch.report.sections.draw_clusters", lambda clusters: None)
