"""Epsilon-SVR with one or several outputs that share their centres."""

from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.svm import inputs
from cgtorch.svm.kernels import Kernel
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.optimality import duality_gap
from cgtorch.svm.problems import regression
from cgtorch.svm.solver import solve


def per_output(
    value: float | Sequence[float],
    name: str,
    outputs: int,
    rows: Tensor,
    check: Callable[[Any, str], float] = inputs.positive,
) -> Tensor:
    """One number per output (k,), on the device of `rows`, from a number or a sequence.

    Raises:
        SettingsError: `check` refuses a number, or a sequence has another length.
    """
    given = list(value) if isinstance(value, Sequence | Tensor | np.ndarray) else [value] * outputs
    if len(given) != outputs:
        raise SettingsError(f"{name} has {len(given)} values for {outputs} outputs")
    return torch.tensor([check(one, name) for one in given], dtype=torch.float64).to(rows)


def units(targets: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (k,) and a power of two near the standard deviation (k,) of targets (k, n).

    The dual problem of (z - mean) / unit with C / unit and epsilon / unit has the coefficients
    beta / unit, so that what counts as small in the solver does not depend on the targets' unit.
    """
    mean = targets.mean(1)
    spread = targets.std(1, correction=0)
    # Where all targets are equal, there is only rounding left.
    unit = torch.exp2(spread.clamp_min(1e-300).log2().round())
    return mean, torch.where(spread > 1e-12 * mean.abs(), unit, 1.0)


class SVR(KernelMachine):
    """Support vector regression, the problem of libsvm's epsilon-SVR for every output.

    The constructor only stores its arguments (scikit-learn's convention). The outputs are solved
    together on one kernel matrix and predict from the union of their support vectors.

    Args:
        C: Cost of a residual beyond the tube, one or one per output.
        kernel: "rbf", "linear", "poly" or a callable (m, d), (n, d) -> (m, n).
        gamma: Width parameter of "rbf" and "poly": "scale", "auto" or a positive number.
        degree: Degree of "poly".
        coef0: Constant of "poly".
        epsilon: Half width of the tube without loss, one or one per output.
        max_memory: Bytes that kernel matrices may take.
    """

    squeeze: Tensor
    tube: Tensor

    def __init__(
        self,
        C: float | Sequence[float] = 1.0,
        *,
        kernel: str | Kernel = "rbf",
        gamma: str | float = "scale",
        degree: int = 3,
        coef0: float = 0.0,
        epsilon: float | Sequence[float] = 0.1,
        max_memory: int = inputs.MAX_MEMORY,
    ) -> None:
        super().__init__()
        self.C, self.epsilon = C, epsilon
        self.kernel, self.gamma, self.degree, self.coef0 = kernel, gamma, degree, coef0
        self.max_memory = max_memory
        self.register_buffer("squeeze", torch.tensor(True))
        self.register_buffer("tube", torch.zeros(1, dtype=torch.float64))

    def fit(self, x: Any, y: Any, *, warm: bool = False) -> Self:
        """Solve the dual problems on rows x (n, d) with targets y (n,) or (n, k).

        With `warm`, the solver starts from the last fit, whose rows have to come first in x.

        Raises:
            DataError: Wrong shapes, NaN, or more rows than `max_memory` allows.
            SettingsError: A parameter cannot be used.
        """
        rows = inputs.as_rows(x)
        given = inputs.as_targets(y, len(rows)).to(rows)
        targets = given.reshape(len(rows), -1).T.contiguous()
        cap = per_output(self.C, "C", len(targets), rows)
        tube = per_output(self.epsilon, "epsilon", len(targets), rows, inputs.not_negative)
        gram = self._gram(rows)
        mean, unit = units(targets)
        scaled = (targets - mean[:, None]) / unit[:, None]
        problems = regression(scaled, cap / unit, tube / unit, torch.ones_like(targets))
        found = solve(gram, problems, self._start(gram, problems, unit) if warm else None)
        beta, bias = found.beta * unit[:, None], found.bias * unit + mean
        gap = duality_gap(problems, found) * unit.square()
        self._keep(rows, beta, bias, gap, gram.gamma)
        self.cost, self.tube = cap, tube
        self.squeeze = torch.tensor(given.ndim == 1, device=rows.device)
        return self

    def forward(self, x: Tensor) -> Tensor:
        """Predictions (..., k), or (...) if fitted on targets (n,), differentiable in x.

        Raises:
            ModelError: Not fitted.
            DataError: Wrong shape.
        """
        values = self.values(x)
        return values[..., 0] if bool(self.squeeze) else values

    def predict(self, x: Any) -> Any:
        """Predictions for rows x (..., d), numpy for numpy."""
        with torch.no_grad():
            return inputs.as_given(self(self._asked(x)), x)

    def score(self, x: Any, y: Any) -> float:
        """Mean over the outputs of R^2, the share of variance explained, on x (n, d), y."""
        truth = inputs.as_tensor(y, "y")
        error = (inputs.as_tensor(self.predict(x), "y").to(truth) - truth).square().sum(0)
        return float((1 - error / (truth - truth.mean(0)).square().sum(0)).mean())
