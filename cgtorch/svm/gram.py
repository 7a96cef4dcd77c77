"""Kernel values among training rows, for torch in double precision and for compiled code."""

import math
from functools import cached_property

import torch
from torch import Tensor

from cgtorch.native import VECTOR, function
from cgtorch.svm.kernels import Kernel, kernel_matrix, make_kernel

_LARGEST = 1e18  # scaled features up to which distances are finite


class Gram:
    """Kernel values between all pairs of n training rows, computed when they are first asked for.

    Rows of the matrices are filled up with finite numbers to whole vectors of compiled code.
    """

    def __init__(
        self,
        kernel: str | Kernel,
        rows: Tensor,
        gamma: float,
        degree: int = 3,
        coef0: float = 0.0,
        threads: int = 1,
    ) -> None:
        """Values of a kernel as `SVC` and `SVR` take it, among rows (n, d) in float64.

        How many threads compiled code may use changes no value.
        """
        self.kernel, self.rows, self.gamma, self.threads = kernel, rows, gamma, threads
        self.function = make_kernel(kernel, gamma, degree, coef0)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def matrix(self) -> Tensor:
        """The kernel matrix (n, n), float64, on the CPU; see `kernel_matrix`."""
        return self.double[:, : len(self)]

    @cached_property
    def double(self) -> Tensor:
        """The kernel matrix (n, n and more), float64, on the CPU."""
        return self._filled(kernel_matrix(self.function, self.rows).cpu().double())

    @cached_property
    def single(self) -> Tensor:
        """The kernel matrix (n, n and more), float32, on the CPU, compiled for "rbf"."""
        call = function("rbf_gram", torch.float32)
        x = self.rows.cpu()
        scaled = (x - x.mean(0)) * (self.gamma * math.log2(math.e)) ** 0.5
        if call is None or self.kernel != "rbf" or not bool((scaled.abs() < _LARGEST).all()):
            return self._filled(self.matrix.float())
        columns = self._filled(scaled.T.contiguous(), torch.float32)
        found = torch.empty(len(x), columns.shape[1])
        call(columns, *x.shape, found.shape[1], found, self.threads)
        return found

    def _filled(self, matrix: Tensor, kind: torch.dtype | None = None) -> Tensor:
        """A matrix (m, n) with columns of zeros up to whole vectors of numbers of a type."""
        more = -matrix.shape[1] % (VECTOR // (kind or matrix.dtype).itemsize)
        return torch.nn.functional.pad(matrix, (0, more))
