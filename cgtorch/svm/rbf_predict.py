"""The hot path: values of an RBF machine with the fewest passes over memory.

With s = gamma log2(e), the kernel is exp2(2 s x'c - s |x|^2 - s |c|^2): one product of the matrix
2 s [C, -1/2, -|c|^2 / 2] with the columns (x, |x|^2, 1)', one exp2 in place, and one product of the
weights with that, in chunks whose buffer stays in cache. Both x and c are taken from the centres'
mean, so that an offset of the features costs no digits.

Rows are columns in here, because a product of few outputs and many rows is faster that way round.

A row has the same values, bit for bit, in whatever batch it comes and on however many threads:
the products and exp2 round odd sizes in other ways, so rows are filled up to multiples of 48,
centres to multiples of 16 and outputs to 2, with weight 0, and sums over features are products
(docs/decisions.md).
"""

import math
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.svm.threads import one_thread_each, side_by_side

LOG2E = math.log2(math.e)
_ROWS, _CENTRES, _OUTPUTS = 48, 16, 2
_CHUNK_BYTES = 1024**2
_SMALLEST_CHUNK, _LARGEST_CHUNK = 128, 1024
_MOST_BYTES = 256 * 1024**2  # of a chunk, however many centres a stranger's model has
_CHUNKS = 4  # in a block, which is what the small operations before and after work on
_WORTH_SHARING = 2**19  # kernel values, about 0.4 ms of one core

Machine = tuple[Tensor, Tensor, Tensor, Tensor]
"""Centres (m, d), weights (m, k), bias (k,) and gamma ()."""

Block = tuple[Tensor, Tensor, Tensor | None]
"""Rows (b, d), where their values (b, k) go, and where the nearest centre's exponents (b,) go."""


def fused_rbf(x: Tensor, centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor) -> Tensor:
    """Values (n, k): sum_j w_j exp(-gamma |x - c_j|^2) + bias, differentiable in all but gamma.

    Args:
        x: Rows (n, d).
        centres: Centres (m, d), at least one.
        weights: Weights (m, k).
        bias: Biases (k,).
        gamma: Kernel width parameter ().
    """
    machine = centres, weights, bias, gamma
    if _wants_gradient(x, *machine):
        return _exponents(x, centres, gamma).exp2() @ weights + bias
    values = x.new_empty(len(x), len(bias))
    _compute(x, machine, values, None)
    return values


def fused_rbf_and_nearest(
    x: Tensor, centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor
) -> tuple[Tensor, Tensor]:
    """As `fused_rbf`, and gamma |x - c|^2 log2(e) of the nearest centre (n,).

    The distance costs one pass over the exponents and no kernel evaluation.
    """
    machine = centres, weights, bias, gamma
    if _wants_gradient(x, *machine):
        exponent = _exponents(x, centres, gamma)
        return exponent.exp2() @ weights + bias, -exponent.amax(1)
    values, nearest = x.new_empty(len(x), len(bias)), x.new_empty(len(x))
    _compute(x, machine, values, nearest)
    return values, nearest.neg_()


def chunk_rows(centres: int, item: int) -> int:
    """Rows per chunk so that the buffer of `centres` columns of `item` bytes stays in cache."""
    row = max(1, centres * item)
    fast = min(_LARGEST_CHUNK, max(_SMALLEST_CHUNK, _CHUNK_BYTES // row))
    return max(1, min(fast, _MOST_BYTES // row) // _ROWS) * _ROWS


def _wants_gradient(*parts: Tensor) -> bool:
    return torch.is_grad_enabled() and any(part.requires_grad for part in parts)


def _exponents(x: Tensor, centres: Tensor, gamma: Tensor) -> Tensor:
    """Base-2 exponents (n, m) of the kernel, with a graph."""
    mean = centres.detach().mean(0)
    rows, others = x - mean, centres - mean
    inner = torch.addmm((others * others).sum(1), rows, others.T, alpha=-2)
    return (inner + (rows * rows).sum(1, keepdim=True)) * (-LOG2E * gamma)


@dataclass(frozen=True)
class _Folded:
    """A machine ready for products, M >= m and K >= k filled up as the module says.

    Attributes:
        matrix: 2 s [C, -1/2, -|c|^2 / 2] (M, d + 2).
        weights: (K, M).
        bias: (k,).
        mean: What is subtracted from rows and centres (d, 1).
        centres: m.
        chunk: Rows that go through the kernel's buffer at once.
    """

    matrix: Tensor
    weights: Tensor
    bias: Tensor
    mean: Tensor
    centres: int
    chunk: int


def _fold(machine: Machine, rows: int) -> _Folded:
    centres, weights, bias, gamma = machine
    m, d = centres.shape
    missing = -m % _CENTRES
    mean = centres.mean(0)
    others = centres - mean
    matrix = centres.new_zeros(m + missing, d + 2)
    matrix[:m, :d] = others
    matrix[:, d] = -0.5
    matrix[:m, d + 1] = -0.5 * (others * others).sum(1)
    return _Folded(
        matrix=matrix.mul_(gamma * (2 * LOG2E)),
        weights=pad(weights.T, (0, missing, 0, max(0, _OUTPUTS - len(bias)))),
        bias=bias,
        mean=mean[:, None],
        centres=m,
        chunk=min(chunk_rows(m + missing, centres.element_size()), max(rows, 1) + -rows % _ROWS),
    )


@torch.inference_mode()
def _compute(x: Tensor, machine: Machine, values: Tensor, nearest: Tensor | None) -> None:
    """Fill `values` (n, k), and `nearest` (n,) if given, from rows x (n, d)."""
    with one_thread_each() as threads:
        folded = _fold(machine, len(x))
        block = folded.chunk * _CHUNKS
        rows = x.split(block)
        ends = nearest.split(block) if nearest is not None else [None] * len(rows)
        todo: SimpleQueue[Block] = SimpleQueue()
        for each in zip(rows, values.split(block), ends, strict=True):
            todo.put(each)
        work = partial(_work_off, todo, folded, min(block, len(x) + -len(x) % _ROWS))
        useful = min(threads, len(rows), len(x) * folded.centres // _WORTH_SHARING)
        if useful > 1 and x.device.type == "cpu":
            side_by_side(work, useful, threads)
        else:
            work()


@torch.inference_mode()
def _work_off(todo: "SimpleQueue[Block]", folded: _Folded, most: int) -> None:
    """Take blocks of at most `most` rows off `todo` until there are none, in the same buffers."""
    matrix, weights, chunk = folded.matrix, folded.weights, folded.chunk
    rows = matrix.new_zeros(matrix.shape[1], most)
    below = matrix.new_tensor([[0.0], [1.0]])
    total = matrix.new_zeros(2, len(rows) - 2)
    total[0] = 1
    kernel = matrix.new_empty(len(matrix), chunk)
    sums = matrix.new_empty(len(weights), most)
    while True:
        try:
            x, values, nearest = todo.get_nowait()
        except Empty:
            return
        n, d = x.shape
        torch.sub(x.T, folded.mean, out=rows[:d, :n])
        near = rows[:d, : n + -n % _ROWS]
        torch.addmm(below, total, near * near, out=rows[d:, : near.shape[1]])
        for begin in range(0, n, chunk):
            last = min(begin + chunk, n)
            end = last + (begin - last) % _ROWS
            part = kernel if end - begin == chunk else matrix.new_empty(len(matrix), end - begin)
            torch.mm(matrix, rows[:, begin:end], out=part)
            if nearest is not None:
                torch.amax(part[: folded.centres, : last - begin], 0, out=nearest[begin:last])
            part.exp2_()
            torch.mm(weights, part, out=sums[:, begin:end])
        torch.add(sums[: len(folded.bias), :n].T, folded.bias, out=values)
