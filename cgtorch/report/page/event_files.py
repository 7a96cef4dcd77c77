"""What TensorBoard files of a run say, read by TensorBoard itself."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

Points: TypeAlias = tuple[tuple[int, float], ...]
"""Steps and the values there, as often as they were written."""


@dataclass(frozen=True)
class Spread:
    """Where the values of a histogram lie."""

    step: int
    low: float
    mean: float
    high: float


@dataclass(frozen=True)
class Told:
    """The scalars and histograms of the files in a folder, by tag; empty if there are none."""

    scalars: dict[str, Points]
    histograms: dict[str, tuple[Spread, ...]]

    def last(self, tag: str) -> float | None:
        """The last value of a scalar, None if it was never written."""
        points = self.scalars.get(tag)
        return points[-1][1] if points else None


def read_event_files(folder: Path, share: float = 0.8) -> Told:
    """All scalars and histograms; what is hidden, as it was done again, stays hidden.

    A file that ends in the middle of a record, as after a power cut, is read up to there.

    Args:
        folder: that has the files.
        share: of a histogram's values that lie between `Spread.low` and `Spread.high`.
    """
    if not any(folder.glob("events.out.tfevents.*")):
        return Told({}, {})
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    everything = {"scalars": 0, "histograms": 0, "images": 1, "tensors": 1}
    events = EventAccumulator(str(folder), size_guidance=everything)
    events.Reload()
    tags = events.Tags()
    return Told(
        {tag: tuple((e.step, e.value) for e in events.Scalars(tag)) for tag in tags["scalars"]},
        {
            tag: tuple(_spread(e, share) for e in events.Histograms(tag))
            for tag in tags["histograms"]
        },
    )


def _spread(event: Any, share: float) -> Spread:
    """The middle of a histogram, as far as its buckets tell."""
    value = event.histogram_value
    count = max(value.num, 1.0)
    bounds = [min(max(limit, value.min), value.max) for limit in value.bucket_limit]
    low, high = ((1 - share) / 2 * count, (1 + share) / 2 * count)
    return Spread(
        event.step,
        _quantile(low, value.bucket, [value.min, *bounds]),
        value.sum / count,
        _quantile(high, value.bucket, [value.min, *bounds]),
    )


def _quantile(rank: float, buckets: list[float], edges: list[float]) -> float:
    """Below which so many values lie, if those of a bucket are spread evenly."""
    below = 0.0
    for i, count in enumerate(buckets):
        if count and below + count >= rank:
            return edges[i] + (edges[i + 1] - edges[i]) * (rank - below) / count
        below += count
    return edges[-1]
