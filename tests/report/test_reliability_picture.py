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


def test_the_title_tells_rows_and_calibration_error() -> None:
    error = (0.01 * 500 + 0.15 * 20 + 0.03 * 300) / 820
    title = draw_reliability(CURVE).axes[0].get_title()
    assert "820 fresh labels" in title
    assert f"{error:.3f}" in title


def test_one_bin_can_be_drawn_and_none_is_an_error() -> None:
    FigureCanvasAgg(draw_reliability(((1.0, 1.0, 3),))).draw()
    with pytest.raises(DataError, match="no rows"):
        draw_reliability(())
