"""Pictures in HTML: text stays text, and no picture has another one's names."""

import re

import jinja2
import pytest
from lxml import etree
from matplotlib import rc_context
from matplotlib.figure import Figure
from support import random_graphs

from cgtorch.graphs import Skill
from cgtorch.ground.errors import printable
from cgtorch.report import draw_skill
from cgtorch.report.html import LEAST, STYLE, inline_svg, templates
from cgtorch.tabletop.actions import paper_actions


def test_names_in_a_graph_are_no_formulas() -> None:
    for name in (r"$\frac{1}{$", "$x$", "a\nb\x1b", "\ud800", " "):
        skill = Skill(name, random_graphs(0, 1, paper_actions()), paper_actions())
        with rc_context(STYLE):
            svg = inline_svg(draw_skill(skill), "key", name)
        assert f"{printable(name)} · " in svg


def test_two_pictures_share_no_names() -> None:
    def picture(key: str) -> str:
        with rc_context(STYLE):
            figure = Figure()
            axes = figure.add_subplot()
            axes.scatter(range(5), range(5), gid="five:all")
            axes.plot([0, 1], [1, 0], color="#123456")
            return inline_svg(figure, key, 'a label with < & "')

    one, other = picture("one"), picture("other")
    assert one == picture("one")
    assert one.replace("one-", "other-") == other
    assert 'data-part="five:all"' in one
    assert "stroke: var(--c-123456, #123456)" in one
    assert 'aria-label="a label with &lt; &amp; &quot;"' in one
    assert "<style" not in one
    assert "<metadata" not in one


HREF = "href"


def tree_of(figure: Figure, key: str = "one", scale: float = 1.0) -> etree._Element:
    return etree.fromstring(inline_svg(figure, key, "a label", scale))


@pytest.fixture(scope="module")
def figure() -> Figure:
    """Marks of a few kinds, a line that is cut off, and a formula."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4, 3), facecolor="#abcdef")
        axes = figure.add_subplot(facecolor="#fedcba", title="$x^2$")
        axes.scatter(range(3), range(3), color="black", linewidths=0, gid="black")
        axes.scatter(range(3), range(3), color="#123456", gid="blue")
        axes.scatter([0.123456], [0.654321], color="#654321", gid="alone")
        axes.scatter(range(2), range(2), color=["#111111", "#222222"], gid="different")
        axes.plot([0, 1], [1, 0], gid="line_1")
        return figure


def test_a_picture_has_the_size_of_its_figure_and_shrinks_no_further_than_can_be_read(
    figure: Figure,
) -> None:
    for scale, width, height in ((1.0, 384, 288), (0.5, 192, 144)):
        svg = tree_of(figure, scale=scale)
        assert (svg.get("width"), svg.get("height")) == (str(width), str(height))
        assert svg.get("style") == f"min-width: {LEAST * width:.0f}px"
        assert svg.get("viewBox") == "0 0 288 216"
        assert (svg.get("role"), svg.get("aria-label")) == ("img", "a label")


def test_the_background_is_left_out(figure: Figure) -> None:
    svg = inline_svg(figure, "one", "a label")
    assert "abcdef" not in svg
    assert "fedcba" not in svg


def test_names_are_those_that_something_refers_to(figure: Figure) -> None:
    svg = tree_of(figure)
    names = [e.get("id") for e in svg.iter() if e.get("id")]
    clipped = [m for e in svg.iter() for m in re.findall(r"#([^)]+)", e.get("clip-path", ""))]
    used = [e.get(HREF).removeprefix("#") for e in svg.iter() if e.get(HREF)]
    assert clipped
    assert used
    assert len(names) == len({*names})
    assert {*names} == {*clipped, *used}
    assert all(name.startswith("one-") and not name.startswith("one-one-") for name in names)
    parts = [e.get("data-part") for e in svg.iter() if e.get("data-part")]
    assert parts == ["black", "blue", "alone", "different"], "which are not of matplotlib"


def test_nothing_is_in_a_picture_that_is_not_shown(figure: Figure) -> None:
    text = str(inline_svg(figure, "one", "a label"))
    assert not re.search(r"<!|xlink|<metadata|>\s+<", text)
    coordinates = [
        value for e in etree.fromstring(text).iter() for name, value in e.attrib.items()
        if name in ("d", "x", "y", "width", "height", "transform")
    ]  # fmt: skip
    assert any(re.search(r"\.\d\d", value) for value in coordinates)
    assert not any(re.search(r"\.\d\d\d", value) for value in coordinates)


def test_the_style_that_marks_share_is_said_by_their_group(figure: Figure) -> None:
    svg = tree_of(figure)
    styles = {
        e.get("data-part"): [
            (mark.getparent().get("style"), mark.get("style"))
            for mark in e.iter("{http://www.w3.org/2000/svg}use")
        ]
        for e in svg.iter()
        if e.get("data-part")
    }
    blue, brown = (f"var(--c-{colour}, #{colour})" for colour in ("123456", "654321"))
    assert styles["black"] == [(None, None)] * 3
    assert styles["blue"] == [(f"fill: {blue}; stroke: {blue}", None)] * 3
    assert styles["alone"] == [(None, f"fill: {brown}; stroke: {brown}")]
    assert [group for group, _ in styles["different"]] == [None, None]
    assert "111111" in styles["different"][0][1]
    assert "222222" in styles["different"][1][1]


def test_a_picture_may_be_as_large_as_it_is() -> None:
    figure = Figure()
    figure.patch.set_gid("x" * 10_000_001)  # more than parsers take from strangers
    assert len(inline_svg(figure, "one", "a label")) > 10_000_000


def test_templates_escape_what_they_are_given_and_want_all_of_it() -> None:
    from_string = templates("cgtorch.report").from_string
    shown = from_string("  {% if true %}\n<p>{{ word }}</p>\n  {% endif %}\n.")
    assert shown.render(word="<b>\x1b") == f"<p>&lt;b&gt;{printable(chr(27))}</p>\n."
    assert from_string("{{ number + 1 }}").render(number=2) == "3"
    with pytest.raises(jinja2.UndefinedError, match="'word' is undefined"):
        shown.render()
