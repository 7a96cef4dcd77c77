"""Epsilon-SVR with one or several outputs that share their centres."""

from collections.abc import Sequence
from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.errors import SettingsError
from cgtorch.models import inputs
from cgtorch.models.kernels import Kernel, kernel_matrix, make_kernel, resolve_gamma
from cgtorch.models.machine import KernelMachine
from cgtorch.models.problems import regression
from cgtorch.models.solver import FINAL_RIDGE, solve


def per_output(value: float | Sequence[float], name: str, outputs: int, rows: Tensor) -> Tensor:
    """One positive number per output (k,) from a number or a sequence.

    Raises:
        SettingsError: A number that is not positive, or a sequence of another length.
    """
    given = list(value) if isinstance(value, Sequence | Tensor) else [value] * outputs
    if len(given) != outputs:
        raise SettingsError(f"{name} has {len(given)} values for {outputs} outputs")
    return torch.tensor([inputs.positive(one, name) for one in given]).to(rows)


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
        seed: Seed or generator of the solver's random quarter.
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
        seed: int | torch.Generator = 0,
        max_memory: int = inputs.MAX_MEMORY,
    ) -> None:
        super().__init__()
        self.C, self.epsilon = C, epsilon
        self.kernel, self.gamma, self.degree, self.coef0 = kernel, gamma, degree, coef0
        self.seed, self.max_memory = seed, max_memory
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
        if self.epsilon == 0:
            tube = torch.zeros_like(cap)
        else:
            tube = per_output(self.epsilon, "epsilon", len(targets), rows)
        inputs.check_memory(len(rows), self.max_memory)
        gamma = resolve_gamma(self.gamma, rows)
        kernel = make_kernel(self.kernel, gamma, self.degree, self.coef0)
        problems = regression(targets, cap, tube, torch.ones_like(targets))
        found = solve(
            kernel_matrix(kernel, rows),
            problems,
            inputs.generator_of(self.seed),
            self._start(len(rows), problems) if warm else None,
            last=FINAL_RIDGE,
            tolerance=1e-6,
        )
        self._keep(rows, found.beta, found.bias, found.gap, gamma)
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
            rows = x if isinstance(x, Tensor) else inputs.as_tensor(x, "x").to(self.centres)
            return inputs.as_given(self(rows), x)

    def score(self, x: Any, y: Any) -> float:
        """Mean over the outputs of R^2, the share of variance explained, on x (n, d), y."""
        truth = inputs.as_tensor(y, "y")
        error = (inputs.as_tensor(self.predict(x), "y").to(truth) - truth).square().sum(0)
        return float((1 - error / (truth - truth.mean(0)).square().sum(0)).mean())
