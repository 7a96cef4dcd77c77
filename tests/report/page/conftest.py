"""The page of the reference run, made once."""

from pathlib import Path

import pytest
from lxml import html
from made_once import made_once, shared_folder
from report_pages import REFERENCE

from cgtorch.report.page import report_page
from cgtorch.runs.stored_run import read_run


@pytest.fixture(scope="session")
def page_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The page as it is written."""
    page = shared_folder(tmp_path_factory) / "page.html"
    return made_once(page, _write).read_bytes()


def _write(page: Path) -> None:
    page.write_bytes(report_page(read_run(REFERENCE)))


@pytest.fixture(scope="session")
def page(page_bytes: bytes) -> html.HtmlElement:
    """The page as a tree."""
    return html.document_fromstring(page_bytes.decode())
