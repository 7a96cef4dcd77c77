"""Plots: a reliability diagram, and those of the page of a run, which are drawn from its log."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from cgtorch.domains.reports import Reliability
from cgtorch.evolution.population import STRATEGY
from cgtorch.ground.errors import DataError
from cgtorch.ground.statistics import wilson
from cgtorch.runs.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GOOD, LINE, FAINT, INK, GRID, PAPER = (
    "#1a7f37", "#4a6fa5", "#a58f6b", "#1c1f24", "#e6e6e6", "#8a6d3b",
)  # fmt: skip
WIDTH = 8.4  # inches
LEFT, RIGHT, BOTTOM, TOP = 0.95, 0.15, 0.5, 0.3  # margins, inches
LETTER = 0.05  # inches below the axes for each letter of a slanted name
MOST_LETTERS = 60  # of names of stages that stand side by side
BINS = 10  # of equal widths, that probabilities were put into
SPREAD = 2.0  # standard errors of a frequency that its bar spans
RATES = {
    "crossover": "crossover",
    "add_node": "add a node",
    "delete_node": "delete a node",
    "new_start": "new start node",
    "replace_node": "replace a node",
    "change_edge": "change an edge",
    "mutate_parameter": "mutate a parameter",
    "sigma": "size of a mutation (σ)",
}

Shares = Sequence[tuple[str, int, int]]
"""Names, numbers of successes, and numbers of trials."""


def plain_figure(
    width: float,
    height: float,
    ratios: Sequence[float] = (1,),
    columns: int = 1,
    share_x: bool = True,
    bottom: float = BOTTOM,
    top: float = TOP,
    gap: float = 0.15,
) -> tuple["Figure", list["Axes"]]:
    """A figure (sizes in inches) and its axes row by row, with heights in these ratios.

    Margins are fixed, as matplotlib takes longer to find them than to draw.
    """
    from matplotlib.figure import Figure

    figure, rows = Figure(figsize=(width, height)), len(ratios)
    room = (width - LEFT - RIGHT) / columns, (height - bottom - top) / rows
    places = {
        "left": LEFT / width, "right": 1 - RIGHT / width, "wspace": 0.5 / room[0],
        "bottom": bottom / height, "top": 1 - top / height, "hspace": gap / (room[1] - gap),
    }  # fmt: skip
    grid = figure.subplots(
        rows, columns, sharex=share_x, height_ratios=ratios, squeeze=False, gridspec_kw=places
    )
    for axes in grid.flat:
        axes.set_axisbelow(True)
        axes.grid(color=GRID, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, list(grid.flat)


def draw_reliability(
    curve: Reliability, *, title: str = "the success classifier C", of: str = "fresh labels"
) -> "Figure":
    """Reliability diagram above a histogram of the probabilities (DeGroot & Fienberg 1983).

    A green dot is a bin of probabilities, and its bar spans two standard errors of the frequency to
    both sides. On the dashed line, probabilities equal frequencies. The title names the model, and
    `of` the rows. DataError if the curve is empty.
    """
    rows = sum(count for _, _, count in curve)
    if rows == 0:
        raise DataError("the reliability curve holds no rows; measure it on some labels")
    mean, frequency, count = np.array(curve).T
    figure, (upper, lower) = plain_figure(5.2, 6.2, (3, 1), top=0.55)
    # By the rule of succession, so that a bin where it always happens has a bar too.
    sure = (frequency * count + 1) / (count + 2)
    bar = SPREAD * np.sqrt(sure * (1 - sure) / count)
    ends = [np.minimum(bar, frequency), np.minimum(bar, 1 - frequency)]
    upper.plot([0, 1], [0, 1], "--", color=FAINT, lw=1.4, zorder=1, label="perfectly calibrated")
    upper.plot(mean, frequency, color=LINE, lw=1.0, zorder=2)
    upper.errorbar(
        mean, frequency, yerr=ends, fmt="o", color=GOOD, ms=6, lw=1.2, capsize=3, zorder=3,
        label="a bin of labels",
    )  # fmt: skip
    upper.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), ylabel="share of tests that succeed")
    upper.legend(loc="upper left", frameon=False, fontsize=9)
    error = float((np.abs(mean - frequency) * count).sum()) / rows
    upper.set_title(
        f"{title} on {rows} {of}\nexpected calibration error {error:.3f}", fontsize=11, color=INK
    )
    for probability, _, number in curve:
        place = (min(int(probability * BINS), BINS - 1) + 0.5) / BINS
        lower.bar(place, number, width=0.92 / BINS, color=LINE, gid="count")
        lower.annotate(
            f"{number}", (place, number), ha="center", va="bottom", fontsize=8, color=INK
        )
    lower.set(yscale="log", ylim=(0.7, 4 * max(count)))
    lower.minorticks_off()
    lower.set(xlabel="probability that C gives", ylabel="labels")
    return figure


def draw_success(
    shares: Shares, others: Shares, label: str, other: str, published: tuple[str, float] | None
) -> "Figure":
    """Success by stage and on other scenarios, with 95 % intervals, and the published share."""
    names = [name for name, _, _ in shares]
    crowded = sum(map(len, names)) > MOST_LETTERS
    below = LETTER * max(map(len, names), default=0) * crowded
    figure, (axes,) = plain_figure(WIDTH, 2.9 + below, bottom=0.3 + below)
    for data, shift, marker, colour, name in (
        (shares, -0.08, "o", GOOD, label),
        (others, 0.08, "s", LINE, other),
    ):
        rows = [(i, s, n) for i, (_, s, n) in enumerate(data) if n]
        if not rows:
            continue
        rate = [s / n for _, s, n in rows]
        low, high = np.array([wilson(s, n, 0.95) for _, s, n in rows]).T
        ends = np.maximum([rate - low, high - rate], 0)
        axes.errorbar(
            [i + shift for i, _, _ in rows], rate, yerr=ends, fmt=marker, ms=5,
            color=colour, capsize=3, lw=1.2, label=name, zorder=3,
        )  # fmt: skip
    if published is not None:
        who, share = published
        axes.axhline(share, color=PAPER, ls="--", lw=1.2)
        axes.plot([], [], color=PAPER, ls="--", lw=1.2, label=f"{who}: {_percent(share)}")
    slanted: dict[str, Any] = {"rotation": 35, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(names)), names, **(slanted if crowded else {}))
    axes.set(xlim=(-0.5, max(len(names), 1) - 0.5), ylim=(0, 1.04), ylabel="scenarios solved")
    axes.yaxis.set_major_formatter(_percent)
    _legend(axes)
    return figure


def draw_fitness(rows: Sequence[Row], stages: Sequence[str], rewarded: bool) -> "Figure":
    """Fitness or mean return of evolutions, the share of unsolved individuals, and graph sizes.

    `rows` are those of all generations in the log; the ends of finished `stages` are marked.
    """
    worthless = "no return" if rewarded else "fitness 0"
    figure, (fitness, unsolved, nodes) = plain_figure(WIDTH, 5.4, (2.2, 1, 1))
    for axes, columns in (
        (fitness, {"best": (GOOD, "the best"), "mean": (LINE, "the mean")}),
        (unsolved, {"unsolved": (LINE, worthless)}),
        (nodes, {"nodes": (GOOD, "the best"), "nodes_mean": (LINE, "the mean")}),
    ):
        for column, (colour, name) in columns.items():
            for i, line in enumerate(_evolutions(rows)):
                known = [(x, row[column]) for x, row in line if row[column] is not None]
                axes.plot(
                    *(zip(*known, strict=True) if known else ((), ())), color=colour, lw=1.3,
                    marker="." if len(known) == 1 else "", label=name if i == 0 else None,
                )  # fmt: skip
        _mark_stages(axes, rows, stages, named=axes is fitness)
    for i, line in enumerate(_evolutions(rows)):
        spread = [(x, row["low"], row["high"]) for x, row in line if row["low"] is not None]
        x, low, high = np.array(spread).reshape(-1, 3).T
        label = "the middle 80 %" if i == 0 else None
        fitness.fill_between(x, low, high, color=LINE, alpha=0.18, lw=0, label=label)
    fitness.set_ylabel("mean return" if rewarded else "fitness (eq. 3)")
    unsolved.set(ylabel=f"share with\n{worthless}", ylim=(-0.03, 1.03))
    unsolved.yaxis.set_major_formatter(_percent)
    nodes.set(ylabel="nodes", xlabel="generation of the run")
    _legend(fitness)
    return figure


def draw_rates(rows: Sequence[Row], stages: Sequence[str]) -> "Figure | None":
    """The strategy parameters of eq. 2 over generations: mean and middle 80 %; None without any."""
    if not any(row["strategy"] for row in rows):
        return None
    figure, grid = plain_figure(WIDTH, 4.0, (1, 1), columns=4, gap=0.35)
    for axes, name in zip(grid, STRATEGY, strict=True):
        for line in _evolutions(rows):
            known = [(x, *row["strategy"].get(name, [])) for x, row in line if row["strategy"]]
            if known:
                x, low, mean, high = zip(*known, strict=True)
                axes.vlines(x, low, high, color=LINE, lw=2.2, alpha=0.35)
                axes.plot(x, mean, color=LINE, lw=1.2, marker=".", ms=4)
        axes.set_title(RATES.get(name, name), fontsize=9, color=INK)
        _mark_stages(axes, rows, stages, named=False)
        axes.set_ylim(bottom=0)
    figure.supxlabel("generation of the run", fontsize=9, color=INK)
    return figure


Curve = tuple[str, Sequence[float], Sequence[float], Sequence[float]]
"""The name of the score, numbers of rows, scores on these rows, and scores on held-out rows."""


def draw_learning(curves: Sequence[Curve]) -> "Figure":
    """Learning curves, one below the other."""
    rows = len(curves)
    figure, grid = plain_figure(5.2, 3.1 * rows, [1] * rows, share_x=False, gap=0.8)
    for axes, (name, sizes, train, test) in zip(grid, curves, strict=True):
        axes.plot(sizes, train, color=FAINT, lw=1.2, marker="s", ms=3.5, label="learned from")
        axes.plot(sizes, test, color=GOOD, lw=1.4, marker="o", ms=4, label="held out")
        axes.set_title(name, fontsize=9.5, color=INK)
        axes.set_xscale("log")
        axes.set_xticks(list(sizes), [f"{size:g}" for size in sizes])
        axes.minorticks_off()
        axes.set_xlabel("rows learned from")
        _legend(axes)
    return figure


def _evolutions(rows: Sequence[Row]) -> Iterable[list[tuple[int, Row]]]:
    """The generations of each evolution, with their numbers in the run, from 1."""
    every = groupby(enumerate(rows, 1), lambda each: (each[1]["stage"], each[1]["candidate"]))
    return (list(line) for _, line in every)


def _mark_stages(axes: "Axes", rows: Sequence[Row], stages: Sequence[str], named: bool) -> None:
    """Mark the ends of stages, and name the stages."""
    axes.set_xlim(0.5, len(rows) + 0.5)
    for name in stages:
        numbers = [i for i, row in enumerate(rows, 1) if row["stage"] == name]
        if not numbers:
            continue
        axes.axvline(numbers[-1] + 0.5, color=FAINT, lw=0.9, ls=":")
        share = len(numbers) / len(rows)
        if named and MOST_LETTERS * share > len(name) / 2 and len(stages) <= 12:
            axes.annotate(
                name, ((numbers[0] + numbers[-1]) / 2, 1), xycoords=("data", "axes fraction"),
                xytext=(0, 3), textcoords="offset points", ha="center", va="bottom", fontsize=8,
                color=PAPER,
            )  # fmt: skip


def _percent(value: float, place: Any = None) -> str:
    return f"{100 * value:.0f} %"


def _legend(axes: "Axes") -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8.5)
