"""Sequential minimal optimisation with libsvm's second working-set selection: slow, but sure.

Fan, Chen & Lin, "Working set selection using second order information for training support
vector machines", JMLR 6 (2005), WSS 2, on the doubled form of Chang & Lin (2011, eq. 11): each
coefficient is the difference of two in [0, upper] and [0, -lower]. It converges for every
positive semidefinite kernel from every feasible start.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.errors import ModelError

_MAX_STEPS = 20_000_000
_TAU = 1e-12

Array = NDArray[np.float64]


def project(beta: Array, lower: Array, upper: Array) -> Array:
    """The feasible point nearest to `beta` (n,): clip(beta - shift) that sums to 0."""
    low = float((beta - upper).min())
    high = float((beta - lower).max())
    for _ in range(100):
        middle = (low + high) / 2
        if np.clip(beta - middle, lower, upper).sum() > 0:
            low = middle
        else:
            high = middle
    result = np.clip(beta - high, lower, upper)
    room = (result > lower) & (result < upper)
    if room.any():
        result[room] -= result.sum() / room.sum()
    return np.clip(result, lower, upper)


def solve(
    kernel: Tensor,
    z: Tensor,
    lower: Tensor,
    upper: Tensor,
    epsilon: float,
    start: Tensor,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    """Solve min 1/2 b'Kb - z'b + epsilon |b|_1 in the box with 1'b = 0.

    Args:
        kernel: Kernel matrix (n, n), positive semidefinite.
        z: Targets (n,).
        lower: Lower ends of the box (n,), at most 0.
        upper: Upper ends of the box (n,), at least 0.
        epsilon: Half width of the insensitive tube.
        start: First coefficients (n,), made feasible by projection.
        tolerance: Largest violation of the optimality conditions at which to stop.

    Returns:
        The coefficients (n,) and the bias ().

    Raises:
        ModelError: After 20 million steps, which only a kernel that is not positive
            semidefinite or a tolerance below rounding can need.
    """
    matrix: Array = kernel.cpu().double().numpy()
    diagonal = matrix.diagonal()
    low: Array = lower.cpu().double().numpy()
    high: Array = upper.cpu().double().numpy()
    beta = project(start.cpu().double().numpy().copy(), low, high)
    gradient = matrix @ beta - z.cpu().double().numpy()
    for _ in range(_MAX_STEPS):
        # Derivatives of the objective for a step up and a step down of each coefficient.
        rise = -(gradient + np.where(beta >= 0, epsilon, -epsilon))
        fall = -(gradient + np.where(beta > 0, epsilon, -epsilon))
        rise[beta >= high] = -np.inf
        fall[beta <= low] = np.inf
        i = int(rise.argmax())
        if rise[i] - fall.min() < tolerance:
            break
        slope = rise[i] - fall
        curvature = np.maximum(diagonal[i] + diagonal - 2 * matrix[i], _TAU)
        j = int(np.where(slope > 0, slope * slope / curvature, -1.0).argmax())
        step = slope[j] / curvature[j]
        # Stop at a bound, or where a coefficient meets the kink of |beta| at 0.
        step = min(step, (high[i] if beta[i] >= 0 else 0.0) - beta[i])
        step = min(step, beta[j] - (low[j] if beta[j] <= 0 else 0.0))
        beta[i] += step
        beta[j] -= step
        gradient += step * (matrix[i] - matrix[j])
    else:
        raise ModelError(
            f"SMO took {_MAX_STEPS} steps without reaching tolerance {tolerance:g}; scale the "
            "features, lower C, or check that the kernel is positive semidefinite"
        )
    free = (beta > low) & (beta < high) & (beta != 0)
    if free.any():
        bias = float((-gradient - epsilon * np.sign(beta))[free].mean())
    else:
        ends = rise.max(), fall.min()
        bias = float(np.mean([end for end in ends if np.isfinite(end)] or [0.0]))
    return torch.from_numpy(beta).to(kernel), torch.tensor(bias).to(kernel)
