"""Whether probabilities mean what they say: how often it happens when C says how likely it is."""

from typing import TYPE_CHECKING

import numpy as np

from cgtorch.domains.reports import Reliability
from cgtorch.ground.errors import DataError
from cgtorch.report.figures import FAINT, GOOD, INK, LINE, plain_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 10  # of equal widths, that the probabilities were put into
SPREAD = 2.0  # standard errors of a frequency that its bar spans


def draw_reliability(
    curve: Reliability, *, title: str = "the success classifier C", of: str = "fresh labels"
) -> "Figure":
    """Reliability diagram above a histogram of the probabilities (DeGroot & Fienberg 1983).

    A green dot is a bin of probabilities, its bar two standard errors of the frequency either way;
    on the dashed line they would be exactly as likely as they say. The title says whose
    probabilities they are, and `of` what the rows are. DataError if the curve holds none.
    """
    rows = sum(count for _, _, count in curve)
    if rows == 0:
        raise DataError("the reliability curve holds no rows; measure it on some labels")
    figure, (upper, lower) = plain_figure(5.2, 6.2, (3, 1))
    _draw_dots(upper, curve)
    _draw_counts(lower, curve)
    error = sum(abs(mean - frequency) * count for mean, frequency, count in curve) / rows
    upper.set_title(
        f"{title} on {rows} {of}\nexpected calibration error {error:.3f}",
        fontsize=11, color=INK,
    )  # fmt: skip
    return figure


def _draw_dots(axes: "Axes", curve: Reliability) -> None:
    mean, frequency, count = np.array(curve).T
    # By the rule of succession, so that a bin where it always happens has a bar too.
    sure = (frequency * count + 1) / (count + 2)
    bar = SPREAD * np.sqrt(sure * (1 - sure) / count)
    ends = [np.minimum(bar, frequency), np.minimum(bar, 1 - frequency)]
    axes.plot([0, 1], [0, 1], "--", color=FAINT, lw=1.4, zorder=1, label="perfectly calibrated")
    axes.plot(mean, frequency, color=LINE, lw=1.0, zorder=2)
    axes.errorbar(
        mean, frequency, yerr=ends, fmt="o", color=GOOD, ms=6, lw=1.2, capsize=3, zorder=3,
        label="a bin of labels",
    )  # fmt: skip
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.02, 1.02)
    axes.set_ylabel("share of tests that succeed")
    axes.legend(loc="upper left", frameon=False, fontsize=9)


def _draw_counts(axes: "Axes", curve: Reliability) -> None:
    for mean, _, count in curve:
        number = min(int(mean * BINS), BINS - 1)
        place = (number + 0.5) / BINS
        axes.bar(place, count, width=0.92 / BINS, color=LINE, gid="count")
        axes.annotate(f"{count}", (place, count), ha="center", va="bottom", fontsize=8, color=INK)
    axes.set_yscale("log")
    axes.set_ylim(0.7, 4 * max(count for _, _, count in curve))
    axes.set_xlabel("probability that C gives")
    axes.set_ylabel("labels")
