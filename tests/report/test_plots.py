"""Plots of a run: what is drawn is what the log says."""

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cgtorch.domains.film import Film
from cgtorch.evolution.population import STRATEGY
from cgtorch.ground.statistics import wilson
from cgtorch.report import failure_section
from cgtorch.report.html import inline_svg
from cgtorch.report.plots import (
    MOST_LETTERS,
    RATES,
    draw_fitness,
    draw_learning,
    draw_rates,
    draw_success,
    plain_figure,
)

SHARES = [("S0", 3, 4), ("S1", 0, 0), ("S2", 10, 10)]
OTHERS = [("S0", 0, 5), ("S1", 2, 4), ("S2", 0, 0)]


def labels(axes: Axes) -> list[str]:
    """The names in a legend."""
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def points(axes: Axes) -> list[list[tuple[float, float]]]:
    """The points of each line of a plot."""
    return [[tuple(p) for p in line.get_xydata().tolist()] for line in axes.lines]


def drawn(figure: Figure) -> list[Axes]:
    FigureCanvasAgg(figure).draw()
    return figure.axes


def test_a_figure_has_plain_axes_row_by_row() -> None:
    figure, axes = plain_figure(4, 3, (3, 1), columns=2)
    assert figure.get_size_inches().tolist() == [4, 3]
    assert len(axes) == 4
    heights = [one.get_position().height for one in drawn(figure)]
    assert heights[0] == pytest.approx(heights[1])
    assert heights[0] > 2 * heights[2]
    axes[0].set_xlim(0, 7)
    assert axes[2].get_xlim() == (0, 7)
    for one in axes:
        assert [one.spines[side].get_visible() for side in ("top", "right")] == [False] * 2
        assert one.spines["left"].get_visible()
        assert one.get_axisbelow()
        for axis in (one.xaxis, one.yaxis):
            assert all(line.get_visible() for line in axis.get_gridlines())
    alone = plain_figure(4, 3, (1, 1), share_x=False)[1]
    alone[0].set_xlim(0, 7)
    assert alone[1].get_xlim() != (0, 7)


def test_shares_have_their_intervals_and_the_published_one_is_a_line() -> None:
    (axes,) = drawn(draw_success(SHARES, OTHERS, "own", "fresh", ("they", 0.87)))
    for container, shares, shift in zip(
        axes.containers, (SHARES, OTHERS), (-0.08, 0.08), strict=True
    ):
        tried = [(i, s, n) for i, (_, s, n) in enumerate(shares) if n]
        dots, _, (bars,) = container.lines  # type: ignore[attr-defined]
        wanted = [(i + shift, s / n) for i, s, n in tried]
        assert dots.get_xydata().tolist() == pytest.approx(np.array(wanted))
        for (_, s, n), bar in zip(tried, bars.get_segments(), strict=True):
            low, high = wilson(s, n, 0.95)
            assert bar[:, 1].tolist() == pytest.approx([min(low, s / n), max(high, s / n)])
    assert labels(axes) == ["they: 87 %", "own", "fresh"]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["S0", "S1", "S2"]
    assert axes.get_xlim() == (-0.5, 2.5)
    dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert [0.87, 0.87] in [list(line.get_ydata()) for line in dashed]
    assert [text.get_text() for text in axes.get_yticklabels()][:2] == ["0 %", "20 %"]
    assert labels(drawn(draw_success(SHARES, [], "own", "fresh", None))[0]) == ["own"]
    low, high = axes.get_ylim()
    assert low == 0
    assert 1 < high < 1.1, "so that all of a dot at 100 % is seen"
    (empty,) = drawn(draw_success([], [], "own", "fresh", None))
    assert labels(empty) == []
    assert empty.get_xlim() == (-0.5, 0.5)


@pytest.mark.parametrize("more", [0, 1])
def test_many_long_names_are_slanted(more: int) -> None:
    names = ["n" * (MOST_LETTERS // 4)] * 3 + ["n" * (MOST_LETTERS // 4 + more)]
    (axes,) = drawn(draw_success([(name, 1, 2) for name in names], [], "own", "fresh", None))
    assert {text.get_rotation() for text in axes.get_xticklabels()} == {35.0 * more}


def row(stage: str, candidate: str, best: float | None, **more: Any) -> dict[str, Any]:
    """A generation in a log, whose numbers follow from its best fitness."""
    known = best is not None
    low, high, mean = (best - d if best is not None else None for d in (0.4, 0.1, 0.2))
    return {
        "stage": stage, "candidate": candidate, "best": best, "mean": mean, "low": low,
        "high": high, "unsolved": 0.75 if known else 1.0, "nodes": 5, "nodes_mean": 4.5,
        "strategy": None, **more,
    }  # fmt: skip


ROWS = [
    row("S0", "a", 0.5), row("S0", "a", 0.6), row("S0", "a", None), row("S0", "b", 0.7),
    row("S1", "b", 0.8), row("S1", "b", 0.9),
]  # fmt: skip


def test_each_evolution_is_a_line_and_each_stage_has_an_end() -> None:
    fitness, unsolved, nodes = draw_fitness(ROWS, ["S9", "S0", "S1", "S2"], rewarded=False).axes
    best = [[(1.0, 0.5), (2.0, 0.6)], [(4.0, 0.7)], [(5.0, 0.8), (6.0, 0.9)]]
    lines = points(fitness)
    assert lines[:3] == best
    for line, wanted in zip(lines[3:6], best, strict=True):
        assert line == [(x, pytest.approx(y - 0.2)) for x, y in wanted]
    assert [line.get_marker() for line in fitness.lines[:3]] == ["", ".", ""]
    assert [line[0][0] for line in lines[6:]] == [4.5, 6.5]  # the ends of stages
    assert labels(fitness) == ["the best", "the mean", "the middle 80 %"]
    bands = [band.get_paths()[0].vertices for band in fitness.collections]
    for band, wanted in zip(bands, best, strict=True):
        edges = {(round(x), round(y, 3)) for x, y in np.asarray(band).tolist()}
        assert edges == {(round(x), round(y - d, 3)) for x, y in wanted for d in (0.4, 0.1)}
    assert [text.get_text() for text in fitness.texts] == ["S0", "S1"]
    assert [text.xy[0] for text in fitness.texts] == [2.5, 5.5]  # type: ignore[attr-defined]
    assert points(unsolved)[0] == [(1, 0.75), (2, 0.75), (3, 1.0)]
    assert points(nodes)[0] == [(1, 5), (2, 5), (3, 5)]
    assert points(nodes)[3] == [(1, 4.5), (2, 4.5), (3, 4.5)]
    assert [axes.get_ylabel() for axes in (fitness, unsolved, nodes)] == [
        "fitness (eq. 3)", "share with\nfitness 0", "nodes",
    ]  # fmt: skip
    assert not [*unsolved.texts, *nodes.texts]
    assert nodes.get_xlabel() == "generation of the run"
    low, high = unsolved.get_ylim()
    assert -0.1 < low < 0 < 1 < high < 1.1
    assert unsolved.yaxis.get_major_formatter()(0.75) == "75 %"
    assert labels(unsolved) == labels(nodes) == []
    assert fitness.get_xlim() == (0.5, 6.5)
    paid = draw_fitness(ROWS, [], rewarded=True).axes
    assert [axes.get_ylabel() for axes in paid[:2]] == ["mean return", "share with\nno return"]


def test_a_stage_too_short_for_its_name_is_only_marked() -> None:
    rows = [row("S0", "a", 0.5)] * 99 + [row("a long name", "b", 0.7)]
    fitness = draw_fitness(rows, ["S0", "a long name"], rewarded=False).axes[0]
    assert [text.get_text() for text in fitness.texts] == ["S0"]
    assert [line[0][0] for line in points(fitness)[-2:]] == [99.5, 100.5]
    many = [f"S{i}" for i in range(13)]
    fitness = draw_fitness([row(s, "a", 0.5) for s in many], many, rewarded=False).axes[0]
    assert not fitness.texts
    few = many[:-1]
    fitness = draw_fitness([row(s, "a", 0.5) for s in few], few, rewarded=False).axes[0]
    assert [text.get_text() for text in fitness.texts] == few
    for text in fitness.texts:
        assert (text.xy[1], text.xyann) == (1, (0, 3)), "above"  # type: ignore[attr-defined]
        assert (text.get_horizontalalignment(), text.get_verticalalignment()) == (
            "center",
            "bottom",
        )


def test_rates_are_a_mean_and_the_middle_of_the_population() -> None:
    assert draw_rates(ROWS, ["S0"]) is None
    spread = {name: [0.1 * i, 0.2 * i, 0.3 * i] for i, name in enumerate(STRATEGY, 1)}
    rows = [ROWS[0], {**ROWS[1], "strategy": spread}, {**ROWS[4], "strategy": spread}]
    figure = draw_rates(rows, ["S0"])
    assert figure is not None
    grid = figure.axes
    assert figure.get_supxlabel() == "generation of the run"
    assert len({axes.get_subplotspec().rowspan.start for axes in grid}) == 2  # type: ignore[union-attr]
    for i, (axes, name) in enumerate(zip(grid, STRATEGY, strict=True), 1):
        assert axes.get_title() == RATES[name]
        assert points(axes)[:2] == [[(2, pytest.approx(0.2 * i))], [(3, pytest.approx(0.2 * i))]]
        bars = [bar.get_segments()[0].tolist() for bar in axes.collections]  # type: ignore[attr-defined]
        assert bars == [[pytest.approx([x, 0.1 * i]), pytest.approx([x, 0.3 * i])] for x in (2, 3)]
        assert points(axes)[2][0][0] == 2.5  # the end of the stage
        assert not axes.texts
        assert axes.get_ylim()[0] == 0
        assert axes.get_xlim() == (0.5, 3.5)


def test_learning_curves_have_a_place_for_each_size() -> None:
    curves = [("r2", [20, 50, 160], [0.9, 0.8, 0.7], [0.1, 0.4, 0.6]), ("error", [30], [1], [2])]
    one, other = drawn(draw_learning(curves))
    assert (one.get_title(), other.get_title()) == ("r2", "error")
    assert points(one) == [[(20, 0.9), (50, 0.8), (160, 0.7)], [(20, 0.1), (50, 0.4), (160, 0.6)]]
    assert points(other) == [[(30, 1)], [(30, 2)]]
    for axes, sizes in ((one, [20, 50, 160]), (other, [30])):
        assert axes.get_xscale() == "log"
        assert axes.get_xticks().tolist() == sizes
        assert [text.get_text() for text in axes.get_xticklabels()] == [str(s) for s in sizes]
        assert axes.get_xticks(minor=True).tolist() == []
        assert labels(axes) == ["learned from", "held out"]
    assert one.get_position().y0 > other.get_position().y1
    assert one.get_xlabel() == other.get_xlabel() == "rows learned from"
    heights = [draw_learning(some).get_size_inches()[1] for some in (curves, curves[:1])]
    assert heights[0] == 2 * heights[1]


def test_a_style_that_all_marks_of_a_group_have_is_said_once() -> None:
    figure = Figure()
    axes = figure.add_subplot()
    axes.scatter(range(50), range(50), color="#123456", gid="alike")
    axes.scatter(range(2), range(2), color=["#111111", "#222222"], gid="different")
    svg = str(inline_svg(figure, "key", "label"))
    assert svg.count("fill: var(--c-123456, #123456)") <= 2  # of the group, and of the mark itself
    for colour in ("111111", "222222"):
        assert f"var(--c-{colour}, #{colour})" in svg


def test_a_film_that_is_too_large_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    film = Film([np.zeros((4, 6, 3), np.uint8)] * 2, 50, "failure")
    monkeypatch.setattr(failure_section, "animated", lambda films, kind: b"12345678")
    for most, shown in ((8, "data:image/webp;base64,MTIzNDU2Nzg="), (7, "")):
        monkeypatch.setattr(failure_section, "MOST_FILMED", most)
        assert failure_section._as_url(film) == shown
