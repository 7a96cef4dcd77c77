"""The machine's ceiling for a kernel evaluation: two products and an exp2, each alone."""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import torch

from benchmarks.measure import (
    CPU,
    WALL,
    Clock,
    Comparison,
    Timing,
    Work,
    in_turns,
    torch_threads,
)

CHUNKS = (256, 512, 1024, 2048, 4096)
STEPS = ("first product", "exp2", "second product")


@dataclass(frozen=True)
class Shape:
    """A kernel evaluation: rows, a multiple of every chunk times the cores, and numbers of each.

    Attributes:
        rows: n.
        inputs: d, columns of the rows.
        centres: m.
        outputs: k, columns of the weights.
    """

    rows: int
    inputs: int
    centres: int
    outputs: int


def against_ceiling(
    label: str, work: Work, shape: Shape, gap: float, repeats: int, count: int
) -> Comparison:
    """The share of what `count` cores can do for this shape that `work` reaches.

    Args:
        label: Of the case.
        work: The evaluation.
        shape: Of the products that it needs.
        gap: The difference of its result from the exact one.
        repeats: Number of samples; each takes a few milliseconds.
        count: Number of threads.
    """
    with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        steps = {name: _fastest(_ways(name, shape, pool, count)) for name in STEPS}
        # A few milliseconds each, many times over: other programs disturb only some of them.
        mine, *bounds = in_turns([work, *steps.values()], 5 * repeats, WALL)
    ceiling = Timing(
        median=sum(t.median for t in bounds),
        fastest=sum(t.fastest for t in bounds),
        slowest=sum(t.slowest for t in bounds),
        repeats=mine.repeats,
    )
    return Comparison(
        label=label,
        ours=mine,
        other=ceiling,
        ratio=ceiling.median / mine.median,
        difference=gap,
        sizes={
            "rows": shape.rows,
            "rows_per_second": shape.rows / mine.median,
            "share of the ceiling, fastest of both": ceiling.fastest / mine.fastest,
            "share of one core's ceiling, CPU seconds": _alone(work, shape, repeats),
            **{f"{k} s": t.median for k, t in zip(steps, bounds, strict=True)},
        },
        note=f"{shape.rows / mine.median:.3g} rows/s",
    )


def _alone(work: Work, shape: Shape, repeats: int) -> float:
    """The share of one core's ceiling that one thread reaches; other load hardly disturbs it."""
    with torch_threads(1):
        steps = [
            _fastest([_step(name, shape, chunk, shape.rows // chunk) for chunk in CHUNKS], CPU)
            for name in STEPS
        ]
        mine, *bounds = in_turns([work, *steps], repeats, CPU)
    return sum(t.median for t in bounds) / mine.median


def _fastest(works: Iterable[Work], clock: Clock = WALL) -> Work:
    """The one of `works` with the lowest median of seven calls."""
    known = list(works)
    times = in_turns(known, 7, clock)
    return known[min(range(len(known)), key=lambda i: times[i].median)]


def _ways(step: str, shape: Shape, pool: ThreadPoolExecutor, count: int) -> Iterator[Work]:
    """Ways to do one step for all rows: with torch's own threads, and one thread per core."""
    for chunk in CHUNKS:
        yield _step(step, shape, chunk, shape.rows // chunk)
        if shape.rows % (chunk * count) == 0:
            times = shape.rows // chunk // count
            share = [_step(step, shape, chunk, times) for _ in range(count)]
            yield partial(_together, pool, share)


def _together(pool: ThreadPoolExecutor, works: list[Work]) -> None:
    for future in [pool.submit(work) for work in works]:
        future.result()


def _step(step: str, shape: Shape, chunk: int, times: int) -> Work:
    """One step of the computation, `times` over on a chunk that stays in cache."""
    features, kernel = torch.rand(chunk, shape.inputs), torch.rand(chunk, shape.centres)
    matrix = torch.rand(shape.inputs, shape.centres)
    weights = torch.rand(shape.centres, shape.outputs)
    out = torch.empty(chunk, shape.outputs)
    once: Work = {
        "first product": lambda: torch.mm(features, matrix, out=kernel),
        "exp2": kernel.exp2_,
        "second product": lambda: torch.mm(kernel, weights, out=out),
    }[step]

    def work() -> None:
        for _ in range(times):
            once()

    return work
