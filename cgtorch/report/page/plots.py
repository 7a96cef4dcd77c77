"""The plots of the page: success by stage, fitness, rates and learning curves."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cgtorch.evolution.population import STRATEGY
from cgtorch.ground.statistics import wilson
from cgtorch.report.figures import FAINT, GOOD, INK, LINE, PAPER, plain_figure
from cgtorch.report.page.course import Course
from cgtorch.report.page.event_files import EventData

WIDTH = 8.4  # inches
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


def draw_success(
    shares: Shares, others: Shares, label: str, other: str, published: tuple[str, float] | None
) -> Figure:
    """Success by stage and on other scenarios, with 95 % intervals, and the published share."""
    figure, (axes,) = plain_figure(WIDTH, 2.9)
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
    names = [name for name, _, _ in shares]
    axes.set_xticks(range(len(names)), names, rotation=90 if len(names) > 10 else 0)
    axes.set_xlim(-0.5, max(len(names), 1) - 0.5)
    axes.set_ylim(0, 1.04)
    axes.yaxis.set_major_formatter(_percent)
    axes.set_ylabel("scenarios solved")
    _legend(axes)
    return figure


def draw_fitness(events: EventData, course: Course, rewarded: bool) -> Figure:
    """Fitness or mean return of evolutions, the share of unsolved individuals, and graph sizes."""
    worthless = "no return" if rewarded else "fitness 0"
    figure, (fitness, unsolved, nodes) = plain_figure(WIDTH, 5.4, (2.2, 1, 1))
    for axes, tags in (
        (fitness, {"fitness/best": (GOOD, "the best"), "fitness/mean": (LINE, "the mean")}),
        (unsolved, {"population/unsolved": (LINE, worthless)}),
        (nodes, {"graph/nodes_best": (GOOD, "the best"), "graph/nodes_mean": (LINE, "the mean")}),
    ):
        for tag, (colour, name) in tags.items():
            for i, line in enumerate(course.lines(events.scalars.get(tag, ()))):
                known = [point for point in line if isfinite(point[1])]
                axes.plot(
                    *(zip(*known, strict=True) if known else ((), ())), color=colour, lw=1.3,
                    marker="." if len(known) == 1 else "", label=name if i == 0 else None,
                )  # fmt: skip
        _stages(axes, course, named=axes is fitness)
    fitness.set_ylabel("mean return" if rewarded else "fitness (eq. 3)")
    unsolved.set_ylabel(f"share with\n{worthless}")
    unsolved.set_ylim(-0.03, 1.03)
    unsolved.yaxis.set_major_formatter(_percent)
    nodes.set_ylabel("nodes")
    nodes.set_xlabel("generation of the run")
    _legend(fitness)
    return figure


def draw_rates(events: EventData, course: Course) -> Figure | None:
    """The strategy parameters of eq. 2 over generations: mean and middle 80 %; None without any."""
    rates = {name: events.histograms.get(f"strategy/{name}", ()) for name in STRATEGY}
    if not any(rates.values()):
        return None
    figure, grid = plain_figure(WIDTH, 4.0, (1, 1), columns=4)
    for axes, (name, spreads) in zip(grid, rates.items(), strict=True):
        for line in course.lines(spreads):
            known = [(x, *spread) for x, spread in line if isfinite(sum(spread))]
            x, low, mean, high = zip(*known, strict=True) if known else [()] * 4
            axes.vlines(x, low, high, color=LINE, lw=2.2, alpha=0.35)
            axes.plot(x, mean, color=LINE, lw=1.2, marker=".", ms=4)
        axes.set_title(RATES.get(name, name), fontsize=9, color=INK)
        _stages(axes, course, named=False)
        axes.set_ylim(bottom=0)
    figure.supxlabel("generation of the run", fontsize=9, color=INK)
    return figure


Curve = tuple[str, Sequence[float], Sequence[float], Sequence[float]]
"""The name of the score, numbers of rows, scores on these rows, and scores on held-out rows."""


def draw_learning(curves: Sequence[Curve]) -> Figure:
    """Learning curves, one below the other."""
    figure, grid = plain_figure(5.2, 3.1 * len(curves), [1] * len(curves), share_x=False)
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


def _stages(axes: Axes, course: Course, named: bool) -> None:
    """Mark the ends of stages, and name the stages."""
    last = len(course.steps)
    axes.set_xlim(0.5, last + 0.5)
    for name, first, end in course.stages:
        axes.axvline(end + 0.5, color=FAINT, lw=0.9, ls=":")
        wide = end - first + 1 > 0.02 * last
        if named and wide and len(course.stages) <= 12:
            axes.annotate(
                name, ((first + end) / 2, 1), xycoords=("data", "axes fraction"), xytext=(0, 3),
                textcoords="offset points", ha="center", va="bottom", fontsize=8, color=PAPER,
            )  # fmt: skip


def _percent(value: float, place: Any = None) -> str:
    return f"{100 * value:.0f} %"


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8.5)
