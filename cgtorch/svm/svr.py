"""Epsilon-SVR with one or several outputs that share their centres."""

from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.svm import inputs
from cgtorch.svm.machine import KernelMachine, PerOutput
from cgtorch.svm.problems import Targets


class SVR(KernelMachine):
    """Support vector regression: the problem of libsvm's epsilon-SVR for every output.

    The outputs are solved together on one kernel matrix, and predict from the union of their
    support vectors. For arguments see `KernelMachine`. Besides its buffers there are `tube` (k,),
    the epsilon of each output, and `squeeze` (), whether targets were given as (n,).
    """

    squeeze: Tensor
    tube: Tensor
    scoring = "r2"

    def __init__(
        self, C: PerOutput = 1.0, *, gamma: str | float = "scale", epsilon: PerOutput = 0.1
    ) -> None:
        super().__init__(C, epsilon, gamma)
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

    def own_state(self, targets: Targets) -> dict[str, Tensor]:
        """See `KernelMachine.own_state`."""
        tube = inputs.per_output(self.epsilon, "epsilon", len(targets.y), inputs.not_negative)
        return {"tube": tube, "squeeze": torch.tensor(targets.single)}

    def learn_on(self, x: Any, y: Any) -> Self:
        """See `KernelMachine.learn_on`."""
        self.epsilon = self.tube.tolist()
        return super().learn_on(x, y)

    def forward(self, x: Tensor) -> Tensor:
        """Predictions (..., k), or (...) if fitted on targets (n,), differentiable in x.

        Errors are those of `KernelMachine.values`.
        """
        values = self.values(x)
        return values[..., 0] if bool(self.squeeze) else values

    def predict(self, x: Any) -> Any:
        """Predictions for rows x (..., d), numpy for numpy."""
        with torch.no_grad():
            return inputs.as_given(self(self._asked(x)), x)
