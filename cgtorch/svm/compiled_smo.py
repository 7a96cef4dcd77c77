"""The dual problems of C-SVC and epsilon-SVR by compiled minimal optimisation (smo.c)."""

import ctypes

from torch import Tensor

from cgtorch.native import function
from cgtorch.native.structures import POINTER, WHOLE
from cgtorch.svm.problems import Problems, State
from cgtorch.svm.smo import GAP


class _Problems(ctypes.Structure):
    """As in smo.c."""

    _fields_ = [
        ("kernel", POINTER), ("n", WHOLE), ("stride", WHOLE), ("count", WHOLE),
        ("z", POINTER), ("lower", POINTER), ("upper", POINTER), ("epsilon", POINTER),
        ("tolerance", ctypes.c_double), ("gap", ctypes.c_double), ("worth", ctypes.c_double),
        ("beta", POINTER), ("gradient", POINTER), ("bias", POINTER), ("violation", POINTER),
    ]  # fmt: skip


def compiled_smo_steps(
    matrix: Tensor, problems: Problems, start: State, tolerance: float, worth: float, threads: int
) -> State | None:
    """Take problems on until they are solved or have cost too much; None without a compiler.

    Args:
        matrix: A matrix of `cgtorch.svm.gram.Gram`, in whose type the steps are made; gradients
            are in double precision all the same.
        problems: P problems over n rows.
        start: Where they stand, with feasible coefficients.
        tolerance: Violation at which a problem is solved, as libsvm counts it.
        worth: Kernel values that each may take; a thousand million take about a quarter second.
        threads: How many share out the problems, which changes no result.
    """
    call = function("smo_problems", matrix.dtype, POINTER, WHOLE)
    if call is None:
        return None
    given = problems.z, problems.lower, problems.upper, problems.epsilon
    parts = [part.contiguous() for part in given]
    beta, gradient = start.beta.clone(), start.product - parts[0]
    bias, violation = start.bias.clone(), start.violation.clone()
    task = _Problems(
        matrix.data_ptr(), len(matrix), matrix.shape[1], len(bias),
        *(part.data_ptr() for part in parts), tolerance, GAP, worth,
        beta.data_ptr(), gradient.data_ptr(), bias.data_ptr(), violation.data_ptr(),
    )  # fmt: skip
    call(ctypes.addressof(task), threads)
    return State(beta, gradient + parts[0], bias, violation)
