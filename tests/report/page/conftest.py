"""The page of the reference run, made once."""

import pytest
from lxml import html
from report_pages import REFERENCE

from cgtorch.report.page import report_page


@pytest.fixture(scope="session")
def page_bytes() -> bytes:
    """The page as it is written."""
    return report_page(REFERENCE)


@pytest.fixture(scope="session")
def page(page_bytes: bytes) -> html.HtmlElement:
    """The page as a tree."""
    return html.document_fromstring(page_bytes.decode())
