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

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.svm.compiled import LOG2E
from cgtorch.svm.threads import one_thread_each

_ROWS, _CENTRES, _OUTPUTS = 48, 16, 2
_CHUNK_BYTES = 1024**2
_SMALLEST_CHUNK, _LARGEST_CHUNK = 128, 1024
_MOST_BYTES = 256 * 1024**2  # of a chunk, however many centres a stranger's model has
_CHUNKS = 4  # in a block, which is what the small operations before and after work on
_WORTH_SHARING = 2**20  # kernel values, about 0.8 ms of one core


def fused_rbf(
    x: Tensor,
    centres: Tensor,
    weights: Tensor,
    bias: Tensor,
    gamma: Tensor,
    with_nearest: bool = True,
) -> tuple[Tensor, Tensor]:
    """Values (n, k): sum_j w_j exp(-gamma |x - c_j|^2) + bias, differentiable in all but gamma.

    With them come gamma |x - c|^2 log2(e) (n,) of the nearest centres, which cost one pass over the
    exponents and no kernel evaluation; where they are not asked for, they are a tensor (0,).

    Args:
        x: Rows (n, d).
        centres: Centres (m, d), at least one.
        weights: Weights (m, k).
        bias: Biases (k,).
        gamma: Kernel width parameter ().
        with_nearest: Whether the nearest centres are asked for.
    """
    tensors = x, centres, weights, bias, gamma
    if torch.is_grad_enabled() and any(each.requires_grad for each in tensors):
        exponent = _exponents(x, centres, gamma)
        return exponent.exp2() @ weights + bias, -exponent.amax(1)
    values, nearest = x.new_empty(len(x), len(bias)), x.new_empty(len(x) if with_nearest else 0)
    with one_thread_each() as threads:
        folded = _folded(centres, weights, bias, gamma, len(x))
        size = folded.chunk * _CHUNKS
        blocks = [slice(begin, begin + size) for begin in range(0, len(x), size)]

        def work(block: slice) -> None:
            _fill(x[block], folded, values[block], nearest[block])

        useful = min(threads, len(blocks), len(x) * len(centres) // _WORTH_SHARING)
        if len(blocks) == 1:
            _fill(x, folded, values, nearest)
        elif useful > 1 and x.device.type == "cpu":
            # Two threads of one torch thread each beat two of torch's, whose every operation waits.
            with ThreadPoolExecutor(useful, "cgtorch", torch.set_num_threads, (1,)) as pool:
                list(pool.map(work, blocks))
        else:
            for block in blocks:
                work(block)
    return values, nearest.neg_()


def chunk_rows(centres: int, item: int) -> int:
    """Rows per chunk so that the buffer of `centres` columns of `item` bytes stays in cache."""
    row = max(1, centres * item)
    fast = min(_LARGEST_CHUNK, max(_SMALLEST_CHUNK, _CHUNK_BYTES // row))
    return max(1, min(fast, _MOST_BYTES // row) // _ROWS) * _ROWS


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


@torch.inference_mode()
def _folded(centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor, rows: int) -> _Folded:
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
def _fill(x: Tensor, folded: _Folded, values: Tensor, nearest: Tensor) -> None:
    """Write values (n, k) of rows (n, d), and their largest exponents (n,) if there is room."""
    matrix, weights, chunk = folded.matrix, folded.weights, folded.chunk
    n, d = x.shape
    whole = n + -n % _ROWS
    rows = matrix.new_zeros(d + 2, whole)
    torch.sub(x.T, folded.mean, out=rows[:d, :n])
    total = matrix.new_zeros(2, d)
    total[0] = 1
    torch.addmm(matrix.new_tensor([[0.0], [1.0]]), total, rows[:d] * rows[:d], out=rows[d:])
    kernel, sums = matrix.new_empty(len(matrix), chunk), matrix.new_empty(len(weights), whole)
    for begin in range(0, n, chunk):
        last, end = min(begin + chunk, n), min(begin + chunk, whole)
        part = kernel if end - begin == chunk else matrix.new_empty(len(matrix), end - begin)
        torch.mm(matrix, rows[:, begin:end], out=part)
        if len(nearest):
            torch.amax(part[: folded.centres, : last - begin], 0, out=nearest[begin:last])
        part.exp2_()
        torch.mm(weights, part, out=sums[:, begin:end])
    torch.add(sums[: len(folded.bias), :n].T, folded.bias, out=values)
