"""Predictions of kernel machines, beside scikit-learn and the machine's ceiling."""

from functools import partial

import numpy as np
import torch
from torch import Tensor

from benchmarks.ceiling import Shape, against_ceiling
from benchmarks.measure import (
    CPU,
    Comparison,
    Effort,
    Line,
    cores,
    difference,
    in_turns,
    torch_threads,
)
from cgtorch.svm import SVR

INPUTS, OUTPUTS = 10, 7
GAMMA = 0.1
PADDED_OUTPUTS = 16


def inference_vs_sklearn(effort: Effort) -> Line:
    """Seven outputs in float32 on one thread against seven SVRs of scikit-learn, in batches."""
    rows = int(10_000 * effort.size)
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
    """The same on all cores, as a share of the machine's ceiling."""
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
    work, shape = partial(machine.predict, asked), Shape(rows, INPUTS, centres, PADDED_OUTPUTS)
    return against_ceiling(f"{centres} centres", work, shape, gap, repeats, count)
