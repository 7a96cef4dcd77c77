"""Sequential minimal optimisation of dual problems: compiled (smo.c), and in plain NumPy.

Fan, Chen & Lin, "Working set selection using second order information for training support vector
machines", JMLR 6 (2005), WSS 2, on the doubled form of Chang & Lin (2011, eq. 11): each coefficient
is the difference of two in [0, upper] and [0, -lower]. The plain code runs without a compiler.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.native import function, structure
from cgtorch.svm.problems import Problems, State, relative_gap

GAP = 5e-3
"""The relative duality gap above which the tolerance is reduced."""

_FINER, _FINEST = 0.25, 1e-3  # of the tolerance, at a time and at most
_TAU = 1e-12

Array = NDArray[np.float64]


def compiled_smo_steps(
    matrix: Tensor, problems: Problems, start: State, tolerance: Tensor, worth: float, threads: int
) -> State | None:
    """Continue P problems until they are solved or have cost too much; None without a compiler.

    The matrix is one of `cgtorch.svm.rbf.Gram`, whose type is that of the steps. A problem ends
    with a violation below its tolerance, of (P,), or after `worth` kernel values; a thousand
    million take about a quarter of a second.
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


def smo_steps(
    kernel: Tensor, problems: Problems, start: State, tolerance: Tensor, most: int
) -> State:
    """Continue P problems from feasible coefficients until they are solved, or after `most` steps.

    The kernel (n, n) must be positive semidefinite. A problem is solved when its violation, as in
    libsvm, is below its tolerance, of (P,).
    """
    matrix: Array = kernel.numpy()
    found = start.take(torch.arange(len(start.bias)))
    for number in range(len(start.bias)):
        one = torch.tensor([number])
        beta, aim, solved = found.beta[number].numpy(), float(tolerance[number]), False
        finest = _FINEST * aim
        z = problems.z[number].numpy()
        gradient = found.product[number].numpy() - z
        while not solved:
            end = _solve(matrix, problems.take(number), beta, gradient, aim, most)
            found.product[number] = torch.from_numpy(gradient + z)
            found.bias[number], found.violation[number] = end
            gap = float(relative_gap(problems.take(one), found.take(one)))
            solved = end[1] >= aim or gap <= GAP or aim < finest
            aim *= _FINER
    return found


def _solve(
    matrix: Array, problem: Problems, beta: Array, gradient: Array, tolerance: float, most: int
) -> tuple[float, float]:
    """Solve one problem in place; the bias, in the middle of optimal ones, and the violation."""
    lower, upper, epsilon = problem.lower.numpy(), problem.upper.numpy(), float(problem.epsilon)
    diagonal = matrix.diagonal()
    for step_number in range(most + 1):
        # Gain of a step up of each coefficient, and cost of a step down.
        rise = -(gradient + np.where(beta >= 0, epsilon, -epsilon))
        fall = -(gradient + np.where(beta > 0, epsilon, -epsilon))
        rise[beta >= upper] = -np.inf
        fall[beta <= lower] = np.inf
        i = int(rise.argmax())
        wrong = float(rise[i] - fall.min())
        if wrong < tolerance or step_number == most:
            break
        slope = rise[i] - fall
        curvature = np.maximum(diagonal[i] + diagonal - 2 * matrix[i], _TAU)
        j = int(np.where(slope > 0, slope * slope / curvature, -1.0).argmax())
        # Stop at a bound, or where a coefficient meets the kink of |beta| at 0.
        top = upper[i] if beta[i] >= 0 else 0.0
        bottom = lower[j] if beta[j] <= 0 else 0.0
        step = min(slope[j] / curvature[j], top - beta[i], beta[j] - bottom)
        beta[i] = top if step == top - beta[i] else beta[i] + step
        beta[j] = bottom if step == beta[j] - bottom else beta[j] - step
        gradient += step * (matrix[i] - matrix[j])
    ends = [end for end in (float(rise.max()), float(fall.min())) if np.isfinite(end)]
    return float(np.mean(ends or [0.0])), max(wrong, 0.0)
