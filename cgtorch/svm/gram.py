"""The radial basis kernel, exp(-gamma |x - s|^2), and its values between training rows."""

import math
from functools import cached_property

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.native import VECTOR, function
from cgtorch.svm.inputs import as_number

_LARGEST = 1e18  # scaled features up to which distances are finite


def rbf(x: Tensor, s: Tensor, gamma: float) -> Tensor:
    """Kernel values (m, n) between rows x (m, d) and s (n, d)."""
    mean = s.mean(0)  # an offset of the features would cost digits
    x, s = x - mean, s - mean
    inner = torch.addmm((s * s).sum(1), x, s.T, alpha=-2.0)
    return inner.add_((x * x).sum(1)[:, None]).clamp_min_(0).mul_(-gamma).exp_()


def resolve_gamma(gamma: str | float, x: Tensor) -> float:
    """The value of `gamma` for training rows x (n, d).

    "scale" is 1 / (d var(x)) over the whole array, as in scikit-learn. SettingsError if `gamma` is
    neither that nor a positive number.
    """
    if gamma == "scale":
        variance = float(x.double().var(correction=0))
        return 1.0 / (x.shape[1] * variance) if variance > 0 else 1.0
    if not 0 < (number := as_number(gamma)) < math.inf:
        raise SettingsError(f'gamma is {gamma!r:.40}; choose "scale" or a positive number')
    return number


class Gram:
    """Kernel values between all pairs of n training rows, computed when first needed.

    Rows of the matrices are padded with finite numbers to whole vectors of compiled code. The
    number of threads changes no value.
    """

    def __init__(self, rows: Tensor, gamma: float, threads: int = 1) -> None:
        """Values of the kernel among rows (n, d) in float64."""
        self.rows, self.gamma, self.threads = rows, gamma, threads

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
        return self._filled(matrix.cpu())

    @cached_property
    def single(self) -> Tensor:
        """The kernel matrix (n, n and more), float32, on the CPU, compiled where it can be."""
        call = function("rbf_gram", torch.float32)
        x = self.rows.cpu()
        scaled = (x - x.mean(0)) * (self.gamma * math.log2(math.e)) ** 0.5
        if call is None or not bool((scaled.abs() < _LARGEST).all()):
            return self._filled(self.matrix.float())
        columns = self._filled(scaled.T.contiguous(), torch.float32)
        found = torch.empty(len(x), columns.shape[1])
        call(columns, *x.shape, found.shape[1], found, self.threads)
        return found

    def _filled(self, matrix: Tensor, kind: torch.dtype | None = None) -> Tensor:
        """A matrix (m, n) padded with columns of zeros to whole vectors of numbers of a type."""
        more = -matrix.shape[1] % (VECTOR // (kind or matrix.dtype).itemsize)
        return torch.nn.functional.pad(matrix, (0, more))
