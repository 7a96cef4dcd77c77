"""The common style of plots: colours, and axes with a faint grid."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GOOD, LINE, FAINT, INK, GRID, PAPER = (
    "#1a7f37", "#4a6fa5", "#a58f6b", "#1c1f24", "#e6e6e6", "#8a6d3b",
)  # fmt: skip


def plain_figure(
    width: float,
    height: float,
    ratios: Sequence[float] = (1,),
    columns: int = 1,
    share_x: bool = True,
) -> tuple["Figure", list["Axes"]]:
    """A figure (sizes in inches) and its axes row by row, with heights in these ratios."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    rows = len(ratios)
    grid = figure.subplots(rows, columns, sharex=share_x, height_ratios=ratios, squeeze=False)
    for axes in grid.flat:
        axes.set_axisbelow(True)
        axes.grid(color=GRID, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, list(grid.flat)
