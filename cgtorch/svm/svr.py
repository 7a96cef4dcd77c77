"""Epsilon-SVR with one or several outputs that share their centres."""

from collections.abc import Sequence
from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.svm import inputs
from cgtorch.svm.gram import Gram
from cgtorch.svm.kernels import Kernel
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.problems import State, Targets


class SVR(KernelMachine):
    """Support vector regression, the problem of libsvm's epsilon-SVR for every output.

    The outputs are solved together on one kernel matrix and predict from the union of their
    support vectors. Besides the buffers of `KernelMachine`, where the other arguments are told, the
    fitted state is `tube` (k,), the epsilon of each output, and `squeeze` (), whether it was fitted
    on targets (n,).

    Args:
        C: Cost of a residual beyond the tube, one or one per output.
        epsilon: Half width of the tube without loss, one or one per output.
    """

    squeeze: Tensor
    tube: Tensor
    scoring = "r2"

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
        super().__init__(kernel, gamma, degree, coef0, max_memory)
        self.C, self.epsilon = C, epsilon
        self.register_buffer("squeeze", torch.tensor(True))
        self.register_buffer("tube", torch.zeros(1, dtype=torch.float64))

    def targets(self, y: Any, rows: Tensor) -> Targets:
        """See `KernelMachine.targets`: numbers (n,) or (n, k)."""
        given = inputs.as_targets(y, len(rows)).to(rows)
        y = given.reshape(len(given), -1).T.contiguous()
        mean, spread = y.mean(1), y.std(1, correction=0)
        unit = torch.exp2(spread.clamp_min(1e-300).log2().round())
        # Where all targets are equal, there is only rounding left.
        unit = torch.where(spread > 1e-12 * mean.abs(), unit, 1.0)
        return Targets(y, (y - mean[:, None]) / unit[:, None], mean, unit, None, given.ndim == 1)

    def row_weights(self, targets: Targets, masks: Tensor) -> Tensor:
        """See `KernelMachine.row_weights`: all rows weigh the same."""
        return masks.to(targets.y)

    def own_state(self, gram: Gram, targets: Targets, found: State) -> dict[str, Tensor]:
        """See `KernelMachine.own_state`."""
        tube = inputs.per_output(self.epsilon, "epsilon", len(targets.y), inputs.not_negative)
        return {"tube": tube, "squeeze": torch.tensor(targets.single)}

    def learn_on(self, x: Any, y: Any) -> Self:
        """See `KernelMachine.learn_on`."""
        self.epsilon = self.tube.tolist()
        return super().learn_on(x, y)

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
