"""Answers of kernel machines: against scikit-learn, and against what the machine can do."""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import torch
from torch import Tensor

from benchmarks.measure import (
    CPU,
    WALL,
    Clock,
    Comparison,
    Effort,
    Line,
    Timing,
    Work,
    cores,
    difference,
    in_turns,
    torch_threads,
)
from cgtorch.models import SVR

INPUTS, OUTPUTS = 10, 7
GAMMA = 0.1
PADDED_OUTPUTS = 16
CHUNKS = (256, 512, 1024, 2048, 4096)
STEPS = ("first product", "exp2", "second product")


def inference_vs_sklearn(effort: Effort) -> Line:
    """Seven outputs in float32 on one thread against seven SVRs of scikit-learn, in batches."""
    rows = int(20_000 * effort.size)
    with torch_threads(1):
        parts = tuple(_against_sklearn(centres, rows, effort.repeats) for centres in (300, 1000))
    return Line(
        name="inference_vs_sklearn",
        compared="SVR.predict, 7 outputs, float32 / 7 sklearn.svm.SVR.predict, one thread",
        unit="x faster",
        target=100.0,
        clock="CPU",
        threads=1,
        parts=parts,
    )


def _against_sklearn(centres: int, rows: int, repeats: int) -> Comparison:
    from sklearn import svm

    rng = np.random.default_rng(0)
    x = rng.standard_normal((centres, INPUTS))
    y = rng.standard_normal((centres, OUTPUTS))
    # Noise fitted within a tube of no width makes a support vector of every row.
    machines = [svm.SVR(C=10.0, gamma=GAMMA, epsilon=1e-6).fit(x, target) for target in y.T]
    weights = np.zeros((centres, OUTPUTS))
    for k, machine in enumerate(machines):
        weights[machine.support_, k] = machine.dual_coef_[0]
    bias = np.concatenate([machine.intercept_ for machine in machines])
    ours = _machine(torch.tensor(x), torch.tensor(weights), torch.tensor(bias))
    asked = rng.standard_normal((rows, INPUTS))
    asked32 = torch.tensor(asked, dtype=torch.float32)

    def theirs() -> np.ndarray:
        return np.stack([machine.predict(asked) for machine in machines], 1)

    gap = difference(ours.predict(asked32), torch.tensor(theirs()), most=1e-4)
    mine, other = in_turns(
        [lambda: ours.predict(asked32), theirs], repeats, CPU, calls=[max(1, 3000 // centres), 1]
    )
    return Comparison(
        label=f"{centres} centres",
        ours=mine,
        other=other,
        ratio=other.median / mine.median,
        difference=gap,
        sizes={
            "rows": rows,
            "support_vectors_of_the_sparsest": min(len(m.support_) for m in machines),
            "rows_per_second": rows / mine.median,
        },
    )


def _machine(centres: Tensor, weights: Tensor, bias: Tensor) -> SVR:
    """An SVR in float32 with these centres (m, d), weights (m, k) and biases (k,)."""
    state = SVR().state_dict() | {
        "centres": centres,
        "weights": weights,
        "bias": bias,
        "gamma_value": torch.tensor(GAMMA),
        "support": torch.arange(len(centres)),
        "squeeze": torch.tensor(False),
    }
    for name in ("gap", "cost", "tube"):
        state[name] = torch.zeros_like(bias)
    machine = SVR()
    machine.load_state_dict(state)
    return machine.float()


def inference_ceiling(effort: Effort) -> Line:
    """The same on all cores, as a share of what the machine can do."""
    rows = int(65_536 * effort.size)  # a multiple of every chunk, so that no step does less
    count = cores()
    with torch_threads(count):
        parts = tuple(_against_ceiling(m, rows, effort.repeats, count) for m in (128, 300, 1000))
    return Line(
        name="inference_ceiling",
        compared=(
            "SVR.predict, 7 outputs, float32 / GEMM rows x inputs x centres, exp2 in cache and "
            "GEMM rows x centres x 16, each alone, best chunks and threads, added"
        ),
        unit="of the ceiling",
        target=0.7,
        clock="wall",
        threads=count,
        parts=parts,
    )


def _against_ceiling(centres: int, rows: int, repeats: int, count: int) -> Comparison:
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(centres, OUTPUTS, generator=generator)
    machine = _machine(
        torch.randn(centres, INPUTS, generator=generator), weights, torch.zeros(OUTPUTS)
    )
    asked = torch.randn(rows, INPUTS, generator=generator)
    exact = torch.exp(-GAMMA * torch.cdist(asked.double(), machine.centres.double()).square())
    gap = difference(machine.predict(asked), exact @ weights.double(), most=1e-4)
    with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        steps = {name: _fastest(_ways(name, centres, rows, pool, count)) for name in STEPS}
        works: list[Work] = [partial(machine.predict, asked), *steps.values()]
        # A few milliseconds each, many times over: other programs disturb only some of them.
        mine, *bounds = in_turns(works, 5 * repeats, WALL)
    ceiling = Timing(
        median=sum(t.median for t in bounds),
        fastest=sum(t.fastest for t in bounds),
        slowest=sum(t.slowest for t in bounds),
        repeats=mine.repeats,
    )
    return Comparison(
        label=f"{centres} centres",
        ours=mine,
        other=ceiling,
        ratio=ceiling.median / mine.median,
        difference=gap,
        sizes={
            "rows": rows,
            "rows_per_second": rows / mine.median,
            "share of the ceiling, fastest of both": ceiling.fastest / mine.fastest,
            "share of one core's ceiling, CPU seconds": _alone(machine, asked, repeats),
            **{f"{k} s": t.median for k, t in zip(steps, bounds, strict=True)},
        },
    )


def _alone(machine: SVR, asked: Tensor, repeats: int) -> float:
    """What one thread reaches of one core's ceiling, which a busy machine hardly disturbs."""
    rows, centres = len(asked), len(machine.centres)
    with torch_threads(1):
        steps = [
            _fastest([_step(name, centres, chunk, rows // chunk) for chunk in CHUNKS], CPU)
            for name in STEPS
        ]
        mine, *bounds = in_turns([partial(machine.predict, asked), *steps], repeats, CPU)
    return sum(t.median for t in bounds) / mine.median


def _fastest(works: Iterable[Work], clock: Clock = WALL) -> Work:
    """The one of `works` with the lowest median of seven; a lucky call says nothing of the rest."""
    known = list(works)
    times = in_turns(known, 7, clock)
    return known[min(range(len(known)), key=lambda i: times[i].median)]


def _ways(
    step: str, centres: int, rows: int, pool: ThreadPoolExecutor, count: int
) -> Iterator[Work]:
    """Ways to do one step for all rows: with torch's own threads, and one thread per core."""
    for chunk in CHUNKS:
        yield _step(step, centres, chunk, rows // chunk)
        if rows % (chunk * count) == 0:
            share = [_step(step, centres, chunk, rows // chunk // count) for _ in range(count)]
            yield partial(_together, pool, share)


def _together(pool: ThreadPoolExecutor, works: list[Work]) -> None:
    for future in [pool.submit(work) for work in works]:
        future.result()


def _step(step: str, centres: int, chunk: int, times: int) -> Work:
    """One step of the computation, `times` over on a chunk that stays in cache."""
    features, kernel = torch.rand(chunk, INPUTS), torch.rand(chunk, centres)
    matrix, weights = torch.rand(INPUTS, centres), torch.rand(centres, PADDED_OUTPUTS)
    out = torch.empty(chunk, PADDED_OUTPUTS)
    once: Work = {
        "first product": lambda: torch.mm(features, matrix, out=kernel),
        "exp2": kernel.exp2_,
        "second product": lambda: torch.mm(kernel, weights, out=out),
    }[step]

    def work() -> None:
        for _ in range(times):
            once()

    return work
