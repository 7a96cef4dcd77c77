"""A kernel matrix in the two precisions that a solver wants, and its blocks."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.models.kernels import Kernel, kernel_matrix, make_kernel

_FEW_FEATURES = 32
_FAINT = 2.0**-40


@dataclass(frozen=True)
class Gram:
    """Kernel values between all pairs of n training rows.

    Attributes:
        matrix: Kernel matrix (n, n), float64.
        single: The same in float32, for directions, which need no more.
        exponents: Two factors (n, e) in float32 whose product is the kernel's logarithm to base 2,
            where computing a block from them is faster than gathering it; else None.
    """

    matrix: Tensor
    single: Tensor
    exponents: tuple[Tensor, Tensor] | None = None

    def __len__(self) -> int:
        return len(self.matrix)

    def block(self, index: Tensor, *, precise: bool) -> Tensor:
        """Kernel values among the rows of `index` (f,), in float64 if `precise`, a new tensor."""
        if self.exponents is not None and not precise:
            left, right = (factor.index_select(0, index) for factor in self.exponents)
            return (left @ right.T).clamp_min_(math.log2(_FAINT)).exp2_()
        source = self.matrix if precise else self.single
        return source.index_select(0, index).index_select(1, index)

    def times(self, d: Tensor, *, precise: bool) -> Tensor:
        """D K (P, n), float64, for directions d (P, n), computed in float32 unless `precise`."""
        matrix = self.matrix if precise else self.single
        columns = d.any(0).nonzero().flatten()
        if 4 * len(columns) > len(matrix):
            return (d.to(matrix.dtype) @ matrix).double()
        return (d[:, columns].to(matrix.dtype) @ matrix[columns]).double()

    def part(self, index: Tensor) -> "Gram":
        """The same for the rows of `index` only."""
        factors = self.exponents
        if factors is not None:
            factors = factors[0][index], factors[1][index]
        matrix, single = self.block(index, precise=True), self.single[index][:, index]
        return Gram(matrix, single, factors)


def gram(
    kernel: str | Kernel, x: Tensor, gamma: float, degree: int = 3, coef0: float = 0.0
) -> Gram:
    """The Gram matrix of rows x (n, d), float64, for a kernel as `SVC` and `SVR` take it.

    Raises:
        SettingsError: The kernel is unknown.
        DataError: It gave another shape or values that are not finite.
    """
    plain = gathered(kernel_matrix(make_kernel(kernel, gamma, degree, coef0), x))
    if kernel != "rbf" or x.shape[1] > _FEW_FEATURES:
        return plain
    scaled = (x - x.mean(0)) * (2 * gamma * math.log2(math.e)) ** 0.5
    half, one = -0.5 * (scaled * scaled).sum(1, keepdim=True), torch.ones_like(x[:, :1])
    left, right = torch.cat([scaled, half, one], 1), torch.cat([scaled, one, half], 1)
    return Gram(plain.matrix, plain.single, (left.float(), right.float()))


def gathered(matrix: Tensor) -> Gram:
    """The Gram of a kernel matrix (n, n), float64, that came from elsewhere.

    Values too small for float32's normalised numbers, after a product or two, are zero in
    `single`, because processors work ten times more slowly with others.
    """
    return Gram(matrix, torch.nn.functional.hardshrink(matrix, _faint(matrix)).float())


def _faint(matrix: Tensor) -> float:
    return _FAINT * float(matrix.diagonal().max().clamp_min(0))
