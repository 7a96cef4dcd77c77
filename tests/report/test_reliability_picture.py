"""The reliability picture: dots where the bins are, and a count for each."""

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from cgtorch.ground.errors import DataError
from cgtorch.report.plots import draw_reliability

CURVE = ((0.01, 0.0, 500), (0.45, 0.6, 20), (0.97, 1.0, 300))


def test_dots_and_counts_are_those_of_the_curve() -> None:
    figure = draw_reliability(CURVE)
    FigureCanvasAgg(figure).draw()
    upper, lower = figure.axes
    drawn = [line for line in upper.lines if line.get_marker() == "o"]
    assert [tuple(p) for p in drawn[0].get_xydata()] == [(m, f) for m, f, _ in CURVE]
    bars = [bar for bar in lower.patches if bar.get_gid() == "count"]
    assert [bar.get_height() for bar in bars] == [500, 20, 300]
    assert [bar.get_x() + bar.get_width() / 2 for bar in bars] == pytest.approx([0.05, 0.45, 0.95])
    assert [text.get_text() for text in lower.texts] == ["500", "20", "300"]
    assert all(0.05 < bar.get_width() < 0.1 for bar in bars), "so that none touches another"
    assert [text.xy[1] for text in lower.texts] == [500, 20, 300]  # type: ignore[attr-defined]
    assert {text.get_verticalalignment() for text in lower.texts} == {"bottom"}
    (diagonal,) = [line for line in upper.lines if line.get_linestyle() == "--"]
    assert [tuple(p) for p in diagonal.get_xydata()] == [(0, 0), (1, 1)]


def test_bars_span_two_standard_errors_and_no_more_than_there_can_be() -> None:
    upper = draw_reliability(CURVE).axes[0]
    (bars,) = upper.containers[0].lines[2]  # type: ignore[attr-defined]
    for (mean, frequency, count), bar in zip(CURVE, bars.get_segments(), strict=True):
        sure = (frequency * count + 1) / (count + 2)  # the rule of succession
        error = 2 * (sure * (1 - sure) / count) ** 0.5
        ends = [max(frequency - error, 0), min(frequency + error, 1)]
        assert bar[:, 1].tolist() == pytest.approx(ends)
        assert bar[:, 0].tolist() == [mean, mean]
        assert ends[0] < ends[1]


def test_every_dot_and_bar_is_within_the_picture_and_said_what_it_is() -> None:
    upper, lower = draw_reliability(((0.0, 0.0, 1), (1.0, 1.0, 90))).axes
    for low, high in (upper.get_xlim(), upper.get_ylim()):
        assert -0.1 < low < 0
        assert 1 < high < 1.1
    assert lower.get_yscale() == "log"
    low, high = lower.get_ylim()
    assert 0 < low < 1, "so that one label has a bar"
    assert 180 < high < 900, "so that the number above a bar has a place"
    assert upper.get_ylabel() == "share of tests that succeed"
    assert (lower.get_xlabel(), lower.get_ylabel()) == ("probability that C gives", "labels")
    legend = upper.get_legend()
    assert legend is not None
    said = [text.get_text() for text in legend.get_texts()]
    assert said == ["perfectly calibrated", "a bin of labels"]


def test_the_title_tells_rows_and_calibration_error() -> None:
    error = (0.01 * 500 + 0.15 * 20 + 0.03 * 300) / 820
    title = draw_reliability(CURVE).axes[0].get_title()
    assert title == (
        f"the success classifier C on 820 fresh labels\nexpected calibration error {error:.3f}"
    )
    other = draw_reliability(CURVE, title="C", of="held-out labels").axes[0].get_title()
    assert other.startswith("C on 820 held-out labels\n")


def test_one_bin_can_be_drawn_and_none_is_an_error() -> None:
    figure = draw_reliability(((1.0, 1.0, 3),))
    FigureCanvasAgg(figure).draw()
    (bar,) = [bar for bar in figure.axes[1].patches if bar.get_gid() == "count"]
    assert bar.get_x() + bar.get_width() / 2 == pytest.approx(0.95)
    with pytest.raises(DataError, match="no rows"):
        draw_reliability(())
