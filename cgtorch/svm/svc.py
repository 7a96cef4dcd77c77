"""C-SVC for two classes, with Platt probabilities."""

from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import ModelError
from cgtorch.svm import inputs
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.platt import probability
from cgtorch.svm.problems import Targets


class SVC(KernelMachine):
    """Support vector classifier for two classes: the problem of libsvm's C-SVC.

    For arguments see `KernelMachine`. Besides its buffers there are `classes` (2,) and the Platt
    parameters `platt` (2,), NaN until they are set (`cgtorch.svm.platt.fit_platt`). Like
    hyper-parameters, they are not changed by a fit.
    """

    classes: Tensor
    platt: Tensor
    scoring = "accuracy"

    def __init__(self, C: float = 1.0, *, gamma: str | float = "scale") -> None:
        super().__init__(C, 0.0, gamma)
        self.register_buffer("classes", torch.tensor([0.0, 1.0], dtype=torch.float64))
        self.register_buffer("platt", torch.full((2,), torch.nan, dtype=torch.float64))

    def targets(self, y: Any, rows: Tensor) -> Targets:
        """See `KernelMachine.targets`: signs of labels (n,)."""
        classes, signs = inputs.as_binary(y, len(rows))
        y, zero = signs.to(rows)[None], rows.new_zeros(1)
        return Targets(y, y, zero, zero + 1, classes.to(rows), True)

    def own_state(self, targets: Targets) -> dict[str, Tensor]:
        """See `KernelMachine.own_state`."""
        assert targets.classes is not None  # noqa: S101
        return {"classes": targets.classes}

    def decision_function(self, x: Any) -> Any:
        """Signed decision values (...), positive for the second class."""
        with torch.no_grad():
            return inputs.as_given(self.values(self._asked(x))[..., 0], x)

    def predict(self, x: Any) -> Any:
        """The class (...) of each row."""
        with torch.no_grad():
            second = self.values(self._asked(x))[..., 0] > 0
            return inputs.as_given(self.classes[second.long()], x)

    def forward(self, x: Tensor) -> Tensor:
        """Probability (...) of the second class for rows x (..., d), differentiable in x.

        Errors are those of `KernelMachine.values`, and ModelError without Platt parameters.
        """
        decision = self.values(x)[..., 0]
        # On a GPU nothing waits to see whether there are probabilities: they are NaN where not.
        if self.platt.is_cpu and not bool(torch.isfinite(self.platt).all()):
            raise ModelError("this SVC has no probabilities; set `platt`, as of `fit_platt`")
        return probability(decision, self.platt[0], self.platt[1])
