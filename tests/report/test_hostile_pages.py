"""Names in a run are text on its page, whatever they are."""

import pytest
from lxml import html
from report_pages import HOSTILE, hostile_run, words

from cgtorch.ground.errors import printable
from cgtorch.report.page import report_page
from cgtorch.runs.stored_run import read_run


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    return report_page(read_run(hostile_run(tmp_path_factory.mktemp("hostile")))).decode()


def test_nothing_becomes_an_element_or_attribute(text: str, page: html.HtmlElement) -> None:
    """No kind of element, comments neither, that the page of the reference run has not."""
    known = {element.tag for element in page.iter()} | {"aside", "ul"}
    page = html.document_fromstring(text)
    assert {element.tag for element in page.iter()} <= known
    for element in page.iter():
        for name, value in element.attrib.items():
            assert not name.startswith("on")
            assert "window.hit" not in value or name in ("aria-label", "data-part")
            if name == "href":
                assert value.startswith("#")


def test_all_of_it_is_there_as_text(text: str) -> None:
    page = html.document_fromstring(text)
    one = " ".join(printable("".join(HOSTILE)).split())
    for place in ("results", "stages", "settings"):
        assert one in words(page.get_element_by_id(place)), place
    assert "window.hit = 2" in words(page.find(".//h1"))
    assert "{{ 7 * 191 }}" in words(page.find(".//title"))
    assert "1337" not in words(page)
    nodes = [words(t) for t in page.iter("text") if "window.hit" in words(t)]
    assert nodes  # in the graph


def test_no_character_that_html_cannot_hold(text: str) -> None:
    assert not {c for c in text if ord(c) < 32} - {"\n", "\t"}
    assert "\ud800" not in text
    text.encode()
