"""The measurement of a line: check that results are equal, then time both sides in turns."""

import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch

from cgtorch import native
from cgtorch.ground.errors import CgtorchError

Work = Callable[[], object]
Clock = Callable[[], float]

WALL: Clock = time.perf_counter
"""The time that a user waits, and the only meaningful clock for several threads."""
CPU: Clock = time.process_time
"""CPU seconds of this process, which other programs disturb least."""


class DisagreementError(CgtorchError, AssertionError):
    """Two alternatives that should give the same result do not, so their times mean nothing."""


@dataclass(frozen=True)
class Effort:
    """How long a measurement may take.

    Attributes:
        repeats: Samples of each alternative, at least 5.
        size: Factor on the sizes that a line can shrink without changing its meaning.
    """

    repeats: int
    size: float


FULL, QUICK = Effort(repeats=9, size=1.0), Effort(repeats=5, size=0.5)


@dataclass(frozen=True)
class Timing:
    """Seconds per call: the median of the samples and their extremes."""

    median: float
    fastest: float
    slowest: float
    repeats: int


@dataclass(frozen=True)
class Comparison:
    """One case of a line.

    Attributes:
        label: The case, such as "300 centres".
        ours: Time of ours.
        other: Time of what it is compared to.
        ratio: What the line reports of it, as a rule other.median / ours.median.
        difference: Largest difference of the results, relative to their range; None where the
            other side has no result, or a random one.
        sizes: Everything that says how large the case is.
        note: What stands below the table, such as a rate.
    """

    label: str
    ours: Timing
    other: Timing
    ratio: float
    difference: float | None
    sizes: dict[str, float] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True)
class Line:
    """One row of the table.

    Attributes:
        name: Key of the ratio.
        compared: What is compared with what, in a few words.
        unit: What the ratio counts, such as "x faster".
        target: The ratio to reach.
        clock: "wall" or "CPU", whose seconds the timings are.
        threads: Threads that each side may use.
        parts: The cases, at least one.
        at_most: Whether the target is the most that the ratio may be, not the least.
    """

    name: str
    compared: str
    unit: str
    target: float
    clock: str
    threads: int
    parts: tuple[Comparison, ...]
    at_most: bool = False

    @property
    def ratio(self) -> float:
        """The worst ratio of the cases."""
        return (max if self.at_most else min)(part.ratio for part in self.parts)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch use `count` threads inside, and as many as before afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def run_threads(count: int) -> Iterator[None]:
    """Threads as in a run of `cgtorch-train` on so many cores: one for torch, all for our own.

    After each operation torch's own threads spin for a while, and take cores from compiled code's.
    """
    with torch_threads(1):
        before = native.use_threads(count)
        try:
            yield
        finally:
            native.use_threads(before)


def in_turns(
    works: Sequence[Work],
    repeats: int,
    clock: Clock = WALL,
    calls: Sequence[int] | None = None,
    warm_up: int = 1,
) -> list[Timing]:
    """Time each of `works` `repeats` times, A B A B ..., after untimed calls.

    Args:
        works: What to time.
        repeats: Samples of each.
        clock: `WALL` or `CPU`.
        calls: Calls in one sample of each, 1 by default; more for very short calls.
        warm_up: Untimed calls of each.

    Returns:
        Seconds per call of each.
    """
    counts = list(calls) if calls else [1] * len(works)
    for work in list(works) * warm_up:
        work()
    samples: list[list[float]] = [[] for _ in works]
    for _ in range(repeats):
        for work, count, kept in zip(works, counts, samples, strict=True):
            begin = clock()
            for _ in range(count):
                work()
            kept.append((clock() - begin) / count)
    return [timing(kept) for kept in samples]


def timing(samples: Sequence[float]) -> Timing:
    """The median and extremes of samples, in seconds."""
    return Timing(statistics.median(samples), min(samples), max(samples), len(samples))


def difference(ours: torch.Tensor, other: torch.Tensor, most: float) -> float:
    """Largest difference of two results, as a share of the range of `other`.

    Raises:
        DisagreementError: It is above `most`, or the shapes differ.
    """
    if ours.shape != other.shape:
        raise DisagreementError(
            f"results have shapes {tuple(ours.shape)} and {tuple(other.shape)}; nothing was timed"
        )
    other = other.double()
    gap = float((ours.double() - other).abs().max() / (other.max() - other.min()).clamp_min(1e-300))
    if not gap <= most:
        raise DisagreementError(
            f"results differ by {gap:.1e} of their range, more than {most:.0e}; nothing was timed"
        )
    return gap
