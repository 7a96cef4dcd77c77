"""The dual problems of C-SVC and epsilon-SVR by compiled sequential minimal optimisation.

Kernel values are in single precision, as libsvm's, gradients in double (smo.c).
"""

import ctypes
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.native import function
from cgtorch.native.structures import POINTER, WHOLE, WIDTH
from cgtorch.svm.kernels import Kernel, kernel_matrix, make_kernel
from cgtorch.svm.problems import Problems

_FILL = WIDTH[torch.float32]
_GAP = 5e-3  # relative duality gap, above which the tolerance falls
_LARGEST = 1e18  # scaled features up to which distances are finite


class _Problems(ctypes.Structure):
    """As in smo.c."""

    _fields_ = [
        ("kernel", POINTER), ("n", WHOLE), ("stride", WHOLE), ("count", WHOLE),
        ("z", POINTER), ("lower", POINTER), ("upper", POINTER), ("epsilon", POINTER),
        ("tolerance", ctypes.c_double), ("gap", ctypes.c_double), ("worth", ctypes.c_double),
        ("beta", POINTER), ("gradient", POINTER), ("bias", POINTER), ("violation", POINTER),
    ]  # fmt: skip


@dataclass(frozen=True)
class Stand:
    """Where each of P problems over n rows stands.

    Attributes:
        beta: Coefficients (P, n) in their boxes, with the sum 0.
        product: K beta (P, n).
        bias: Biases (P,), in the middle of what is optimal.
        violation: Largest violation of the optimality conditions (P,), as libsvm counts it.
    """

    beta: Tensor
    product: Tensor
    bias: Tensor
    violation: Tensor

    def take(self, index: Tensor) -> "Stand":
        """The problems of `index` (Q,)."""
        return Stand(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def put(self, index: Tensor, other: "Stand") -> None:
        """Write the problems of another one to `index` (Q,)."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[index] = getattr(other, name)


def at_zero(problems: Problems) -> Stand:
    """The beginning, of which nothing is known."""
    zero = torch.zeros_like(problems.z)
    return Stand(zero, zero.clone(), zero[:, 0].clone(), torch.full_like(zero[:, 0], torch.inf))


def compiled_gram(
    kernel: str | Kernel, x: Tensor, gamma: float, degree: int, coef0: float, threads: int
) -> Tensor | None:
    """The kernel matrix of rows x (n, d) in float32, its rows filled up to whole vectors, or None.

    None where nothing is compiled or x is not on the CPU.

    Raises:
        SettingsError: The kernel is unknown.
        DataError: It gave another shape or values that are not finite.
    """
    call = function("rbf_gram", torch.float32, POINTER, WHOLE, WHOLE, WHOLE, POINTER, WHOLE)
    if call is None or x.device.type != "cpu":
        return None
    n, d = x.shape
    stride = n + -n % _FILL
    scaled = (x - x.mean(0)) * (gamma * math.log2(math.e)) ** 0.5
    if kernel != "rbf" or not bool((scaled.abs() < _LARGEST).all()):
        matrix = kernel_matrix(make_kernel(kernel, gamma, degree, coef0), x)
        return torch.nn.functional.pad(matrix.float(), (0, stride - n))
    columns = torch.nn.functional.pad(scaled.T, (0, stride - n)).contiguous()
    found = torch.empty(n, stride)
    call(columns.data_ptr(), n, d, stride, found.data_ptr(), threads)
    return found


def smo_steps(
    matrix: Tensor, problems: Problems, start: Stand, tolerance: float, worth: float, threads: int
) -> Stand:
    """Take problems on until they are solved or have cost too much.

    Args:
        matrix: Kernel matrix of `compiled_gram` (n, stride).
        problems: P problems over n rows.
        start: Where they stand, with feasible coefficients.
        tolerance: Violation at which a problem is solved, as libsvm counts it.
        worth: Kernel values that each may take; a thousand million take about a quarter second.
        threads: How many share out the problems, which changes no result.
    """
    call = function("smo_problems", torch.float32, POINTER, WHOLE)
    if call is None:
        return start
    given = problems.z, problems.lower, problems.upper, problems.epsilon
    parts = [part.contiguous() for part in given]
    beta, gradient = start.beta.clone(), start.product - parts[0]
    bias, violation = start.bias.clone(), start.violation.clone()
    task = _Problems(
        matrix.data_ptr(), len(matrix), matrix.shape[1], len(bias),
        *(part.data_ptr() for part in parts), tolerance, _GAP, worth,
        beta.data_ptr(), gradient.data_ptr(), bias.data_ptr(), violation.data_ptr(),
    )  # fmt: skip
    call(ctypes.addressof(task), threads)
    return Stand(beta, gradient + parts[0], bias, violation)
