"""The dual problems of C-SVC and epsilon-SVR by compiled minimal optimisation (smo.c)."""

from torch import Tensor

from cgtorch.native import function, structure
from cgtorch.svm.problems import Problems, State
from cgtorch.svm.smo import GAP


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
    call = function("smo_problems", matrix.dtype)
    if call is None:
        return None
    z = problems.z.contiguous()
    found = State(
        start.beta.clone(), start.product - z, start.bias.clone(), start.violation.clone()
    )
    task = structure("Problems", matrix.dtype)(
        kernel=matrix, n=len(matrix), stride=matrix.shape[1], count=len(z),
        z=z, lower=problems.lower, upper=problems.upper, epsilon=problems.epsilon,
        tolerance=tolerance, gap=GAP, worth=worth, beta=found.beta, gradient=found.product,
        bias=found.bias, violation=found.violation,
    )  # fmt: skip
    call(task, threads)
    return State(found.beta, found.product + z, found.bias, found.violation)
