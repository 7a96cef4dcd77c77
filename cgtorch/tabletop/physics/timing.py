"""Timing of a way of joints."""

import numpy
from numpy.typing import NDArray

Array = NDArray[numpy.float64]

ACCELERATE = 0.3  # s to full speed, and from it to rest
SMOOTH = 0.1  # s over which corners of the way are rounded


def timed(way: Array, speed: Array, tick: float) -> Array:
    """Postures (T, n) at every tick (s) of a way (W, n), from rest to rest.

    No joint is faster than its `speed` (n,), rad/s or m/s, on any part of the way.
    """
    steps = numpy.abs(numpy.diff(way, axis=0))
    spent = numpy.concatenate([[0.0], numpy.cumsum((steps / speed).max(1, initial=0.0))])
    total = float(spent[-1])
    if total <= 0:
        return way[-1:]
    rise = min(ACCELERATE, total)
    lasts = total + rise
    when = numpy.minimum(numpy.arange(1, int(numpy.ceil(lasts / tick)) + 1) * tick, lasts)
    early, late = when < rise, when > lasts - rise
    done = when - rise / 2
    done = numpy.where(early, when**2 / (2 * rise), done)
    done = numpy.where(late, total - (lasts - when) ** 2 / (2 * rise), done)
    rows = numpy.stack([numpy.interp(done, spent, column) for column in way.T], 1)
    return _rounded(rows, round(SMOOTH / tick), way[0], way[-1])


def _rounded(rows: Array, window: int, first: Array, last: Array) -> Array:
    """Moving averages, which keep the first and the last row."""
    padded = numpy.concatenate(
        [numpy.repeat(first[None], window, 0), rows, numpy.repeat(last[None], window, 0)]
    )
    total = numpy.cumsum(padded, 0)
    mean = (total[window:] - total[:-window]) / window
    mean[-1] = last
    return mean
