"""Kernel functions: radial basis, linear, polynomial, and whatever the user brings.

A kernel maps rows x (m, d) and centres s (n, d) to values (m, n) and has to be positive
semidefinite. The formulas are those of libsvm (Chang & Lin 2011). A name or a number that cannot be
used is a SettingsError.
"""

from collections.abc import Callable
from math import inf, isfinite, nan

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.svm.inputs import as_number

Kernel = Callable[[Tensor, Tensor], Tensor]

KERNELS = ("rbf", "linear", "poly")


def squared_distance(x: Tensor, s: Tensor) -> Tensor:
    """Squared Euclidean distances (m, n) between rows x (m, d) and s (n, d), never negative."""
    mean = s.mean(0)  # an offset of the features would cost digits
    x, s = x - mean, s - mean
    inner = torch.addmm((s * s).sum(1), x, s.T, alpha=-2.0)
    return inner.add_((x * x).sum(1)[:, None]).clamp_min_(0)


def rbf(x: Tensor, s: Tensor, gamma: float) -> Tensor:
    """exp(-gamma |x - s|^2), (m, n)."""
    return squared_distance(x, s).mul_(-gamma).exp_()


def make_kernel(kernel: str | Kernel, gamma: float, degree: int = 3, coef0: float = 0.0) -> Kernel:
    """The kernel function of a name in `KERNELS`, or the callable itself."""
    if callable(kernel):
        return kernel
    if kernel == "poly" and not (isinstance(degree, int) and degree >= 0 and isfinite(coef0)):
        raise SettingsError(
            f"degree is {degree!r:.40} and coef0 {coef0!r:.40}; pass a whole number from 0 on and "
            "a finite one"
        )
    if kernel == "rbf":
        return lambda x, s: rbf(x, s, gamma)
    if kernel == "linear":
        return lambda x, s: x @ s.T
    if kernel == "poly":
        return lambda x, s: (gamma * (x @ s.T) + coef0) ** degree
    raise SettingsError(f"kernel is {kernel!r}; choose one of {KERNELS} or pass a callable")


def resolve_gamma(gamma: str | float, x: Tensor) -> float:
    """The number that `gamma` stands for on training rows x (n, d).

    "scale" is 1 / (d var(x)) over the whole array and "auto" 1 / d, as in scikit-learn.
    """
    if gamma == "auto":
        return 1.0 / x.shape[1]
    if gamma == "scale":
        variance = float(x.double().var(correction=0))
        return 1.0 / (x.shape[1] * variance) if variance > 0 else 1.0
    number = nan if isinstance(gamma, str) else as_number(gamma)
    if not 0 < number < inf:
        raise SettingsError(f'gamma is {gamma!r:.40}; choose "scale", "auto" or a positive number')
    return number


def kernel_matrix(kernel: Kernel, x: Tensor) -> Tensor:
    """Symmetric kernel matrix (n, n) of rows x (n, d).

    Raises:
        DataError: The kernel returned another shape or non-finite values.
    """
    matrix = kernel(x, x)
    if matrix.shape != (len(x), len(x)):
        raise DataError(
            f"the kernel returned shape {tuple(matrix.shape)} for {len(x)} rows; "
            f"it must return ({len(x)}, {len(x)})"
        )
    # A sum costs a tenth; where it is too large itself, all numbers are looked at.
    if not bool(matrix.sum().isfinite() or torch.isfinite(matrix).all()):
        raise DataError("the kernel gave non-finite values; scale the features or change gamma")
    return matrix
