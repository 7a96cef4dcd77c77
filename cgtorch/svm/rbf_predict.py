"""Values of an RBF machine with few passes over memory; this is the hot path.

With s = gamma log2(e), the kernel is exp2(2 s x'c - s |x|^2 - s |c|^2). It takes one product of the
matrix 2 s [C, -1/2, -|c|^2 / 2] with the columns (x, |x|^2, 1)', one exp2 in place, and one product
of the weights with that, in chunks whose buffer stays in cache. The centres' mean is subtracted
from both x and c, so that an offset of the features costs no digits.

Rows are stored as columns here, because a product with few outputs and many rows is faster that
way.

A row has the same values, bit for bit, in any batch and on any number of threads. Products and exp2
round odd sizes differently, so rows are padded to multiples of 48, centres to multiples of 16 and
outputs to multiples of 2, with weight 0. Sums over features are computed as products
(docs/decisions/models.md).
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.processes import kept_threads, one_thread_each
from cgtorch.svm.compiled import LOG2E

_ROWS, _CENTRES, _OUTPUTS = 48, 16, 2
_CHUNK_BYTES = 1024**2
_SMALLEST_CHUNK, _LARGEST_CHUNK = 128, 1024
_MOST_BYTES = 256 * 1024**2  # of a chunk, however many centres a stranger's model has
_CHUNKS = 4  # in a block, which is what the small operations before and after work on
_WORTH_SHARING = 2**20  # kernel values, about 0.8 ms of one core


def predict_rbf(
    x: Tensor,
    centres: Tensor,
    weights: Tensor,
    bias: Tensor,
    gamma: Tensor,
    with_nearest: bool = True,
) -> tuple[Tensor, Tensor]:
    """Values (n, k) of rows x (n, d): sum_j w_j exp(-gamma |x - c_j|^2) + bias (k,).

    There are centres (m, d), at least one, weights (m, k) and gamma (). There are gradients for all
    arguments except gamma. Also returned are gamma |x - c|^2 log2(e) (n,) of the nearest centres,
    which cost one pass over the exponents and no kernel evaluation; they are (0,) without
    `with_nearest`.
    """
    tensors = x, centres, weights, bias, gamma
    if torch.is_grad_enabled() and any(each.requires_grad for each in tensors):
        exponent = _exponents(x, centres, gamma)
        return exponent.exp2() @ weights + bias, -exponent.amax(1)
    values, nearest = x.new_empty(len(x), len(bias)), x.new_empty(len(x) if with_nearest else 0)
    with one_thread_each() as threads:
        most = chunk_rows(len(centres) + -len(centres) % _CENTRES, centres.element_size())
        chunk = min(most, max(len(x), 1) + -len(x) % _ROWS)
        fill, size = _filler(centres, weights, bias, gamma, chunk), chunk * _CHUNKS
        blocks = [slice(begin, begin + size) for begin in range(0, len(x), size)]
        parts = [[rows[block] for block in blocks] for rows in (x, values, nearest)]
        useful = min(threads, len(blocks), len(x) * len(centres) // _WORTH_SHARING)
        if useful > 1 and x.device.type == "cpu":
            # Two threads of one torch thread each beat two of torch's, whose every operation waits.
            list(kept_threads(useful).map(fill, *parts))
        else:
            for part in zip(*parts, strict=True):
                fill(*part)
    return values, nearest.neg_()


def chunk_rows(centres: int, item: int) -> int:
    """Rows per chunk, so that the buffer of `centres` columns of `item` bytes stays in cache."""
    row = max(1, centres * item)
    fast = min(_LARGEST_CHUNK, max(_SMALLEST_CHUNK, _CHUNK_BYTES // row))
    return max(1, min(fast, _MOST_BYTES // row) // _ROWS) * _ROWS


def _exponents(x: Tensor, centres: Tensor, gamma: Tensor) -> Tensor:
    """Base-2 exponents (n, m) of the kernel, differentiable."""
    mean = centres.detach().mean(0)
    rows, others = x - mean, centres - mean
    inner = torch.addmm((others * others).sum(1), rows, others.T, alpha=-2)
    return (inner + (rows * rows).sum(1, keepdim=True)) * (-LOG2E * gamma)


@torch.inference_mode()
def _filler(
    centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor, chunk: int
) -> Callable[[Tensor, Tensor, Tensor], None]:
    """A function that writes a machine's values, with centres and outputs padded."""
    (m, d), k = centres.shape, len(bias)
    missing = -m % _CENTRES
    mean = centres.mean(0)[:, None]
    others = centres - mean.T
    matrix = centres.new_zeros(m + missing, d + 2)  # 2 s [C, -1/2, -|c|^2 / 2]
    matrix[:m, :d] = others
    matrix[:, d] = -0.5
    matrix[:m, d + 1] = -0.5 * (others * others).sum(1)
    matrix.mul_(gamma * (2 * LOG2E))
    outputs = pad(weights.T, (0, missing, 0, max(0, _OUTPUTS - k)))

    @torch.inference_mode()
    def fill(x: Tensor, values: Tensor, nearest: Tensor) -> None:
        """Write values (n, k) of rows (n, d), and their largest exponents (n,) if there is room."""
        n = len(x)
        whole = n + -n % _ROWS
        rows = matrix.new_zeros(d + 2, whole)
        torch.sub(x.T, mean, out=rows[:d, :n])
        total = matrix.new_zeros(2, d)
        total[0] = 1
        torch.addmm(matrix.new_tensor([[0.0], [1.0]]), total, rows[:d] * rows[:d], out=rows[d:])
        kernel, sums = matrix.new_empty(len(matrix), chunk), matrix.new_empty(len(outputs), whole)
        for begin in range(0, n, chunk):
            last, end = min(begin + chunk, n), min(begin + chunk, whole)
            part = kernel if end - begin == chunk else matrix.new_empty(len(matrix), end - begin)
            torch.mm(matrix, rows[:, begin:end], out=part)
            if len(nearest):
                torch.amax(part[:m, : last - begin], 0, out=nearest[begin:last])
            part.exp2_()
            torch.mm(outputs, part, out=sums[:, begin:end])
        torch.add(sums[:k, :n].T, bias, out=values)

    return fill
