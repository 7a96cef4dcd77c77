"""The data in the TensorBoard files of a run, read by TensorBoard's own reader."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

SHARE = 0.8
"""The share of a histogram's values between `Spread.low` and `Spread.high`."""


class Spread(NamedTuple):
    """The middle and the mean of the values of a histogram."""

    low: float
    mean: float
    high: float


@dataclass(frozen=True)
class EventData:
    """The content of a folder's files, by tag: steps with scalars or histograms."""

    scalars: dict[str, tuple[tuple[int, float], ...]]
    histograms: dict[str, tuple[tuple[int, Spread], ...]]

    def last(self, tag: str) -> float | None:
        """The last value of a scalar, or None."""
        points = self.scalars.get(tag)
        return points[-1][1] if points else None


def read_event_files(folder: Path) -> EventData:
    """Scalars and histograms, without those of repeated steps; a truncated file up to its end."""
    if not any(folder.glob("events.out.tfevents.*")):
        return EventData({}, {})
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    # It warns of steps that come twice, as they do where a run was resumed.
    logging.getLogger("tensorboard").setLevel(logging.ERROR)
    everything = {"scalars": 0, "histograms": 0, "images": 1, "tensors": 1}
    events = EventAccumulator(str(folder), size_guidance=everything)
    events.Reload()
    tags = events.Tags()
    return EventData(
        {tag: tuple((e.step, e.value) for e in events.Scalars(tag)) for tag in tags["scalars"]},
        {
            tag: tuple((e.step, _spread(e.histogram_value)) for e in events.Histograms(tag))
            for tag in tags["histograms"]
        },
    )


def _spread(value: Any) -> Spread:
    """The middle part of a histogram, with values evenly distributed in each bucket."""
    filled = np.array(value.bucket) > 0
    ends = np.clip(value.bucket_limit, value.min, value.max)
    starts = np.concatenate([[value.min], ends[:-1]])
    counts = np.array(value.bucket)[filled]
    if not len(counts):
        return Spread(value.max, value.sum, value.max)
    before = np.cumsum(counts) - counts
    ranks = np.array([1 - SHARE, 1 + SHARE]) / 2 * value.num
    which = np.searchsorted(np.cumsum(counts), ranks).clip(max=len(counts) - 1)
    inside = (ranks - before[which]) / counts[which]
    low, high = starts[filled][which] + inside * (ends - starts)[filled][which]
    return Spread(float(low), value.sum / value.num, float(high))
