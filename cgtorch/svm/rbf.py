"""The radial basis kernel exp(-gamma |x - s|^2): its matrices, and values of machines.

A row has the same values, bit for bit, in any batch and on any number of threads.
"""

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.native import VECTOR, constants, function, structure, threads
from cgtorch.native.processes import kept_threads, one_thread_each
from cgtorch.svm.inputs import as_number

LOG2E = math.log2(math.e)
WORTH_SHARING = 2**19
"""Kernel values for which one more thread pays off: about a quarter of a millisecond in C."""

_LARGEST = 1e18  # scaled features up to which distances are finite
_ROWS, _CENTRES, _OUTPUTS = 48, 16, 2  # multiples of which torch rounds all rows alike
_CHUNK_BYTES = 1024**2
_SMALLEST_CHUNK, _LARGEST_CHUNK = 128, 1024
_MOST_BYTES = 256 * 1024**2  # of a chunk, for any number of centres
_CHUNKS = 4  # in a block, which is what the small operations before and after work on


def rbf(x: Tensor, s: Tensor, gamma: float) -> Tensor:
    """Kernel values (m, n) between rows x (m, d) and s (n, d)."""
    if _far(s, gamma):
        return _squares(x, s).mul_(-gamma).exp_()
    mean = s.mean(0)  # an offset of the features would cost digits
    x, s = x - mean, s - mean
    inner = torch.addmm((s * s).sum(1), x, s.T, alpha=-2.0)
    return inner.add_((x * x).sum(1)[:, None]).clamp_min_(0).mul_(-gamma).exp_()


def _far(s: Tensor, gamma: float | Tensor) -> bool:
    """Whether one of the centres s (m, d) is too far for distances as sums of products.

    Their rounding errors are those of the largest square. It may take half of the digits. On a GPU,
    where nothing waits for a number, and in exports all centres are taken to be near.
    """
    if not s.is_cpu or torch.compiler.is_compiling():
        return False
    largest = (s - s.mean(0)).square().sum(1).max()
    return bool(gamma * largest > torch.finfo(s.dtype).eps ** -0.5)


def _squares(x: Tensor, s: Tensor) -> Tensor:
    """Squared distances (m, n) between rows x (m, d) and s (n, d), from each difference."""
    return torch.cdist(x, s, compute_mode="donot_use_mm_for_euclid_dist").square()


def _resolved(gamma: str | float, x: Tensor) -> float:
    """The number that `gamma` is for training rows x (n, d)."""
    if gamma == "scale":
        variance = float(x.double().var(correction=0))
        return 1.0 / (x.shape[1] * variance) if variance > 0 else 1.0
    if not 0 < (number := as_number(gamma)) < math.inf:
        raise SettingsError(f'gamma is {gamma!r:.40}; choose "scale" or a positive number')
    return number


class Gram:
    """Kernel values between all pairs of n training rows (n, d), computed when first needed.

    Rows of the matrices are padded with finite numbers to whole vectors of compiled code. A `gamma`
    of "scale" is 1 / (d var(x)) over the whole array, as in scikit-learn. SettingsError if it is
    neither that nor a positive number. By default compiled code uses as many threads as torch.
    """

    def __init__(self, rows: Tensor, gamma: str | float, most_threads: int = 0) -> None:
        """Values of the kernel among rows (n, d) in float64."""
        self.rows, self.gamma = rows, _resolved(gamma, rows)
        self.threads = most_threads or threads()

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def matrix(self) -> Tensor:
        """The kernel matrix (n, n), float64, on the CPU; DataError if it is not finite."""
        return self.double[:, : len(self)]

    @cached_property
    def double(self) -> Tensor:
        """The kernel matrix (n, n and more), float64, on the CPU."""
        matrix = rbf(self.rows, self.rows, self.gamma)
        if not bool(matrix.sum().isfinite()):
            raise DataError("the kernel gave non-finite values; scale the features or change gamma")
        return _filled(matrix.cpu(), matrix.dtype)

    @cached_property
    def single(self) -> Tensor:
        """The kernel matrix (n, n and more), float32, on the CPU, compiled where it can be."""
        call = function("rbf_gram", torch.float32)
        x = self.rows.cpu()
        scaled = (x - x.mean(0)) * (self.gamma * LOG2E) ** 0.5
        if call is None or not bool((scaled.abs() < _LARGEST).all()):
            return _filled(self.matrix.float(), torch.float32)
        columns = _filled(scaled.T.contiguous(), torch.float32)
        found = torch.empty(len(x), columns.shape[1])
        call(columns, *x.shape, found.shape[1], found, self.threads)
        return found


def _filled(matrix: Tensor, dtype: torch.dtype) -> Tensor:
    """A matrix (m, n) padded with columns of zeros to whole vectors of numbers of a type."""
    return pad(matrix, (0, -matrix.shape[1] % (VECTOR // dtype.itemsize)))


def machine_structure(centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor) -> Any:
    """A machine of centres (m, d), weights (m, k), bias (k,) and gamma () for compiled code.

    None if nothing is compiled, or the machine is too large.
    """
    (m, d), k = centres.shape, len(bias)
    machine, most = structure("Machine", centres.dtype), constants("machine_limits", centres.dtype)
    if machine is None or not 0 < d <= most["MOST_FEATURES"]:
        return None
    if not 0 < k <= most["MOST_OUTPUTS"] or m == 0:
        return None
    scale, more = math.sqrt(float(gamma) * LOG2E), -m % (VECTOR // centres.element_size())
    scaled = (centres * scale).T
    # Filled up with a centre that is there already, so that no other is nearest; its weight is 0.
    columns = torch.cat([scaled, scaled[:, :1].expand(d, more)], 1)
    rows = torch.cat([weights.T, weights.new_zeros(k, more)], 1)
    return machine(centres=columns, weights=rows, bias=bias, scale=scale, m=m + more, d=d, k=k)


def machine_values(
    x: Tensor, centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor
) -> tuple[Tensor, Tensor] | None:
    """The result of `predict_rbf` but for its last digits, or None as in `machine_structure`."""
    machine = machine_structure(centres, weights, bias, gamma)
    if machine is None:
        return None
    x = x.contiguous()
    values, nearest = x.new_empty(len(x), len(bias)), x.new_empty(len(x))
    share = threads_for(len(x), len(centres))
    function("rbf_values", x.dtype)(machine, x, len(x), values, nearest, share)
    return values, nearest


def threads_for(rows: int, centres: int) -> int:
    """The number of threads that pays off for so many kernel values."""
    return max(1, min(threads(), rows * centres // WORTH_SHARING))


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
    or (0,) without `with_nearest`.
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
        useful = min(threads, len(blocks), len(x) * len(centres) // (2 * WORTH_SHARING))
        # Two threads of one torch thread each beat two of torch's, whose every operation waits.
        shared = useful > 1 and x.device.type == "cpu"
        list((kept_threads(useful).map if shared else map)(fill, *parts))
    return values, nearest.neg_()


def chunk_rows(centres: int, item: int) -> int:
    """Rows per chunk, so that the buffer of `centres` columns of `item` bytes stays in cache."""
    row = max(1, centres * item)
    fast = min(_LARGEST_CHUNK, max(_SMALLEST_CHUNK, _CHUNK_BYTES // row))
    return max(1, min(fast, _MOST_BYTES // row) // _ROWS) * _ROWS


def _exponents(x: Tensor, centres: Tensor, gamma: Tensor) -> Tensor:
    """Base-2 exponents (n, m) of the kernel, differentiable."""
    if _far(centres.detach(), gamma):
        return _squares(x, centres) * (-LOG2E * gamma)
    mean = centres.detach().mean(0)
    rows, others = x - mean, centres - mean
    inner = torch.addmm((others * others).sum(1), rows, others.T, alpha=-2)
    return (inner + (rows * rows).sum(1, keepdim=True)) * (-LOG2E * gamma)


@torch.inference_mode()
def _filler(
    centres: Tensor, weights: Tensor, bias: Tensor, gamma: Tensor, chunk: int
) -> Callable[[Tensor, Tensor, Tensor], None]:
    """A function that writes a machine's values with few passes over memory; the hot path.

    With s = gamma log2(e), the kernel is exp2(2 s x'c - s |x|^2 - s |c|^2): one product of the
    matrix 2 s [C, -1/2, -|c|^2 / 2] with the columns (x, |x|^2, 1)', one exp2 in place, and one
    product of the weights with that, in chunks whose buffer stays in cache. Rows are columns, which
    is faster for few outputs. Products and exp2 round odd sizes differently, so all sizes are
    padded, and sums over features are products (docs/decisions/models.md).
    """
    (m, d), k = centres.shape, len(bias)
    missing = -m % _CENTRES
    mean = centres.mean(0)[:, None]  # an offset of the features would cost digits
    others = centres - mean.T
    matrix = centres.new_zeros(m + missing, d + 2)
    matrix[:m, :d] = others
    matrix[:, d] = -0.5
    matrix[:m, d + 1] = -0.5 * (others * others).sum(1)
    matrix.mul_(gamma * (2 * LOG2E))
    outputs = pad(weights.T, (0, missing, 0, max(0, _OUTPUTS - k)))
    far = pad(centres, (0, 0, 0, missing)) if _far(centres, gamma) else None

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
            if far is None:
                torch.mm(matrix, rows[:, begin:end], out=part)
            else:
                exponents = _squares(far, x[begin:last]).mul_(-LOG2E * gamma)
                part.copy_(pad(exponents, (0, end - last)))
            if len(nearest):
                torch.amax(part[:m, : last - begin], 0, out=nearest[begin:last])
            part.exp2_()
            torch.mm(outputs, part, out=sums[:, begin:end])
        torch.add(sums[:k, :n].T, bias, out=values)

    return fill
