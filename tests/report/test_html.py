"""Pictures in HTML: text stays text, and no picture has another one's names."""

from matplotlib import rc_context
from matplotlib.figure import Figure
from support import random_graphs

from cgtorch.graphs import Skill
from cgtorch.ground.errors import printable
from cgtorch.report import draw_skill
from cgtorch.report.html import STYLE, inline_svg
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
