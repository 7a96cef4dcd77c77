"""The hot path: values of an RBF machine with the fewest passes over memory.

With s = gamma log2(e), the kernel is exp2(-s |c|^2 + 2 s x'c - s |x|^2): one addmm of the rows
(x, |x|^2) with the matrix [2 s C'; -s], one exp2 in place, and one addmm with the weights, in
chunks whose buffer stays in cache. The weights are padded to 16 columns because narrow matrix
products run at a fraction of the peak.
"""

import math

import torch
from torch import Tensor

_LOG2E = math.log2(math.e)
_COLUMNS = 16
_CHUNK_BYTES = 4 * 1024**2
_SMALLEST_CHUNK, _LARGEST_CHUNK = 128, 2048


def fused_rbf(
    x: Tensor, centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor
) -> tuple[Tensor, Tensor]:
    """Values sum_j w_j exp(-gamma |x - c_j|^2) + bias and the nearest centre's distance.

    Args:
        x: Rows (n, d).
        centres: Centres (m, d).
        weights: Weights (m, k).
        bias: Biases (k,).
        gamma: Kernel width parameter ().

    Returns:
        Values (n, k), and gamma |x - c|^2 log2(e) of the nearest centre (n,), which costs one
        pass over the exponents and no kernel evaluation. Both are differentiable in x.
    """
    scale = gamma * _LOG2E
    matrix = torch.cat([2 * scale * centres.T, (-scale).expand(1, len(centres))])
    offset = -scale * (centres * centres).sum(1)
    rows = torch.cat([x, (x * x).sum(1, keepdim=True)], dim=1)
    k = weights.shape[1]
    missing = -k % _COLUMNS if k > 1 else 0
    padded = torch.nn.functional.pad(weights, (0, missing))
    shifted = torch.nn.functional.pad(bias, (0, missing))
    if torch.is_grad_enabled() and any(t.requires_grad for t in (x, centres, weights, bias)):
        exponent = torch.addmm(offset, rows, matrix)
        nearest = -exponent.amax(1)
        return torch.addmm(shifted, exponent.exp2(), padded)[:, :k], nearest
    return _chunked(rows, matrix, offset, padded, shifted, k)


def chunk_rows(centres: int, item: int) -> int:
    """Rows per chunk so that the buffer of `centres` columns of `item` bytes stays in cache."""
    fitting = _CHUNK_BYTES // max(1, centres * item)
    return min(_LARGEST_CHUNK, max(_SMALLEST_CHUNK, fitting))


@torch.no_grad()
def _chunked(
    rows: Tensor, matrix: Tensor, offset: Tensor, padded: Tensor, shifted: Tensor, k: int
) -> tuple[Tensor, Tensor]:
    """`fused_rbf` without a graph, through one reused buffer."""
    n, m = len(rows), matrix.shape[1]
    size = min(max(n, 1), chunk_rows(m, rows.element_size()))
    values, nearest = rows.new_empty(n, k), rows.new_empty(n)
    buffer = rows.new_empty(size, m)
    for begin in range(0, n, size):
        end = min(begin + size, n)
        exponent = buffer[: end - begin]
        torch.addmm(offset, rows[begin:end], matrix, out=exponent)
        torch.amax(exponent, 1, out=nearest[begin:end])
        kernel = exponent.exp2_()
        values[begin:end] = torch.addmm(shifted, kernel, padded)[:, :k]
    return values, nearest.neg_()
