"""The page of a run in a browser, opened as a file."""

from pathlib import Path
from urllib.parse import quote

import pytest
from chromium import visit
from playwright.sync_api import Browser, expect
from report_pages import REFERENCE, hostile_run

from cgtorch.report.page import report_page
from cgtorch.runs.stored_run import read_run

DRAWN = """svg => {
    const box = svg.getBoundingClientRect();
    const inner = svg.getBBox();
    return [box.width, box.height, inner.width, inner.height,
            svg.querySelectorAll("path, use, rect, circle, ellipse").length];
}"""
FAR_OUT = """() => [...document.querySelectorAll("svg text")].filter(text => {
    const svg = text.ownerSVGElement.getBoundingClientRect(), box = text.getBoundingClientRect();
    return box.left < svg.left - 4 || box.right > svg.right + 4;
}).map(text => text.textContent)"""
OVER_THE_RIM = """() => [...document.querySelectorAll('g[data-part^="node:"]')].filter(node => {
    const text = node.ownerSVGElement.querySelector(
        'g[data-part=' + CSS.escape('text:' + node.dataset.part) + ']');
    const inner = text.getBoundingClientRect(), outer = node.getBoundingClientRect();
    return inner.left < outer.left || inner.right > outer.right;
}).map(node => node.dataset.part)"""


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_bytes(report_page(read_run(REFERENCE)))
    return path.as_uri()


@pytest.mark.parametrize("width", [1280, 375])
def test_every_picture_is_drawn(chromium: Browser, reference: str, width: int) -> None:
    with visit(chromium, reference, width=width) as at:
        asked: list[str] = []
        at.page.on("request", lambda request: asked.append(request.url))
        at.page.reload()
        pictures = at.page.locator("svg")
        assert pictures.count() == 17
        for i in range(pictures.count()):
            *sizes, shapes = pictures.nth(i).evaluate(DRAWN)
            assert min(sizes) > 50
            assert shapes > 5
        assert at.page.evaluate(FAR_OUT) == []
        assert at.page.evaluate(OVER_THE_RIM) == []
        # Only tables and pictures scroll to the side, never the page.
        assert at.page.evaluate("document.documentElement.scrollWidth") <= width
        assert asked == [reference]
        assert at.errors == []


def test_links_and_tables_work_with_the_keyboard(chromium: Browser, reference: str) -> None:
    with visit(chromium, reference) as at:
        at.page.keyboard.press("Tab")
        assert at.page.evaluate("document.activeElement.textContent") == "Skip to the results"
        at.page.get_by_role("link", name="S2", exact=True).click()
        expect(at.page.get_by_role("heading", name="S2: right")).to_be_in_viewport()
        details = at.page.get_by_text("The graph of S2 as tables")
        details.focus()
        at.page.keyboard.press("Enter")
        assert at.page.locator("#stage-3 details table").first.is_visible()
        assert at.errors == []


def test_it_is_dark_where_all_is_dark(chromium: Browser, reference: str) -> None:
    """Text stands out from what is behind it, in either scheme: 4.5 to 1, as WCAG asks."""
    colours = """() => [...document.querySelectorAll("body, h1, figcaption, a, dt, th, svg text")]
        .map(e => e instanceof SVGElement ? getComputedStyle(e).fill : getComputedStyle(e).color)"""
    with visit(chromium, reference) as at:
        for scheme in ("light", "dark"):
            at.page.emulate_media(color_scheme=scheme)
            behind = at.page.evaluate("getComputedStyle(document.body).backgroundColor")
            found = set(at.page.evaluate(colours)) - {"rgb(255, 255, 255)"}  # on red and green
            assert len(found) > 4
            assert luminance(behind) < 0.05 or scheme == "light"
            for colour in found:
                assert contrast(colour, behind) > 4, (scheme, colour)


def luminance(colour: str) -> float:
    """Relative luminance of "rgb(r, g, b)" (WCAG 2.2)."""
    parts = [int(part) / 255 for part in colour[4:-1].split(",")]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.hostile
def test_hostile_names_do_nothing(chromium: Browser, tmp_path: Path) -> None:
    path = tmp_path / "hostile.html"
    path.write_bytes(report_page(read_run(hostile_run(tmp_path))))
    with visit(chromium, f"file://{quote(str(path))}") as at:
        at.page.wait_for_load_state("networkidle")
        assert at.page.evaluate("window.hit") is None
        assert "window.hit = 2" in (at.page.locator("h1").text_content() or "")
        assert at.errors == []
