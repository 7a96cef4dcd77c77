"""A kernel matrix, its blocks, and products with it."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.native import function, threads
from cgtorch.native.structures import POINTER, WHOLE, suits
from cgtorch.svm.kernels import Kernel, kernel_matrix, make_kernel

_FEW_FEATURES = 32
_FAINT = 2.0**-40
_SPARSE = 2  # where fewer than one coefficient in so many is not zero, the others are left out
_TYPES = (POINTER, WHOLE, POINTER, WHOLE, WHOLE, POINTER, WHOLE)


@dataclass(frozen=True)
class Gram:
    """Kernel values between all pairs of n training rows.

    Attributes:
        matrix: Kernel matrix (n, n), float64.
        exponents: Two factors (n, e) in float32 whose product is the kernel's logarithm to base 2,
            where computing a block from them is faster than gathering it; else None.
    """

    matrix: Tensor
    exponents: tuple[Tensor, Tensor] | None = None

    def __len__(self) -> int:
        return len(self.matrix)

    def block(self, index: Tensor, *, precise: bool) -> Tensor:
        """Kernel values among the rows of `index` (f,), float64 if `precise`, else float32.

        Values too small for float32's normalised numbers after a product or two are raised or set
        to zero, because processors work ten times more slowly with others.
        """
        if self.exponents is not None and not precise:
            left, right = (factor.index_select(0, index) for factor in self.exponents)
            return (left @ right.T).clamp_min_(math.log2(_FAINT)).exp2_()
        block = self.matrix.index_select(0, index).index_select(1, index)
        if precise:
            return block
        faint = _FAINT * float(block.diagonal().max().clamp_min(0))
        return torch.nn.functional.hardshrink(block, faint).float()

    def times(self, d: Tensor) -> Tensor:
        """D K (P, n) of coefficients d (P, n) of which often few columns are not zero."""
        filled = int(d.count_nonzero())
        if _SPARSE * filled < d.numel() and (found := self._times_compiled(d, filled)) is not None:
            return found
        columns = d.any(0).nonzero().flatten()
        if 4 * len(columns) > len(self):
            return d @ self.matrix
        return d[:, columns] @ self.matrix[columns]

    def _times_compiled(self, d: Tensor, filled: int) -> Tensor | None:
        """The same, where it can be compiled, in a time that grows as the coefficients but zero."""
        call = function("gram_times", torch.float32, *_TYPES)  # in double precision in each library
        if call is None or not self.matrix.is_contiguous() or not suits(d, self.matrix):
            return None
        d, out = d.contiguous(), torch.empty_like(d)
        if call(
            self.matrix.data_ptr(), len(self), d.data_ptr(), len(d), filled, out.data_ptr(),
            threads(),
        ):  # fmt: skip
            raise MemoryError(f"no memory for {filled} coefficients")
        return out

    def part(self, index: Tensor) -> "Gram":
        """The same for the rows of `index` only."""
        factors = self.exponents
        if factors is not None:
            factors = factors[0][index], factors[1][index]
        return Gram(self.block(index, precise=True), factors)


def gram(
    kernel: str | Kernel, x: Tensor, gamma: float, degree: int = 3, coef0: float = 0.0
) -> Gram:
    """The Gram matrix of rows x (n, d), float64, for a kernel as `SVC` and `SVR` take it.

    Raises:
        SettingsError: The kernel is unknown.
        DataError: It gave another shape or values that are not finite.
    """
    matrix = kernel_matrix(make_kernel(kernel, gamma, degree, coef0), x)
    if kernel != "rbf" or x.shape[1] > _FEW_FEATURES:
        return Gram(matrix)
    scaled = (x - x.mean(0)) * (2 * gamma * math.log2(math.e)) ** 0.5
    half, one = -0.5 * (scaled * scaled).sum(1, keepdim=True), torch.ones_like(x[:, :1])
    left, right = torch.cat([scaled, half, one], 1), torch.cat([scaled, one, half], 1)
    return Gram(matrix, (left.float(), right.float()))
