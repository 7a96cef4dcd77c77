"""C-SVC for two classes, with Platt probabilities."""

from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError, ModelError, SettingsError
from cgtorch.svm import inputs
from cgtorch.svm.folds import fold_numbers, training_masks
from cgtorch.svm.gram import Gram
from cgtorch.svm.kernels import Kernel
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.platt import fit_platt, probability
from cgtorch.svm.problems import State, Targets
from cgtorch.svm.solver import solve, start_at

ClassWeight = str | dict[float, float] | None


class SVC(KernelMachine):
    """Support vector classifier for two classes, the problem of libsvm's C-SVC.

    Besides the buffers of `KernelMachine`, where the other arguments are told, the fitted state
    is `classes` (2,) and the Platt parameters `platt` (2,).

    Args:
        C: Cost of a violated margin.
        class_weight: None, "balanced", or a factor on C per class.
        probability: Fit Platt probabilities by cross-validation.
        folds: Number of stratified folds for them, or fold numbers (n,), or (train, test) pairs.
        seed: Seed or generator of the folds.
    """

    classes: Tensor
    platt: Tensor
    scoring = "accuracy"
    epsilon = 0.0

    def __init__(
        self,
        C: float = 1.0,
        *,
        kernel: str | Kernel = "rbf",
        gamma: str | float = "scale",
        degree: int = 3,
        coef0: float = 0.0,
        class_weight: ClassWeight = None,
        probability: bool = False,
        folds: Any = 5,
        seed: int | torch.Generator = 0,
        max_memory: int = inputs.MAX_MEMORY,
    ) -> None:
        super().__init__(kernel, gamma, degree, coef0, max_memory)
        self.C, self.class_weight = C, class_weight
        self.probability, self.folds, self.seed = probability, folds, seed
        self.register_buffer("classes", torch.tensor([0.0, 1.0], dtype=torch.float64))
        self.register_buffer("platt", torch.full((2,), torch.nan, dtype=torch.float64))

    def targets(self, y: Any, rows: Tensor) -> Targets:
        """See `KernelMachine.targets`: signs of labels (n,)."""
        classes, signs = inputs.as_binary(y, len(rows))
        y, zero = signs.to(rows)[None], rows.new_zeros(1)
        return Targets(y, y, zero, zero + 1, classes.to(rows), True)

    def row_weights(self, targets: Targets, masks: Tensor) -> Tensor:
        """See `KernelMachine.row_weights`.

        "balanced" weighs a class by rows / (2 rows of the class) among the rows of the mask.
        """
        signs, weight, kept = targets.y[0], self.class_weight, masks.to(targets.y)
        count = torch.stack([(kept * (signs < 0)).sum(1), (kept * (signs > 0)).sum(1)], dim=1)
        if bool((count == 0).any()):
            raise DataError("a training fold holds one class only; use fewer or stratified folds")
        if weight is None:
            return kept
        if weight == "balanced":
            each = count.sum(1, keepdim=True) / (2 * count)
        elif isinstance(weight, dict) and targets.classes is not None:
            classes = targets.classes.tolist()
            unknown = [c for c in weight if c not in classes]
            if unknown:
                raise SettingsError(f"class_weight has {unknown[0]!r:.40}, which is no label in y")
            pair = [inputs.positive(weight.get(c, 1.0), "class_weight") for c in classes]
            each = torch.tensor(pair, dtype=torch.float64).to(signs).expand(len(kept), 2)
        else:
            raise SettingsError(f'class_weight is {weight!r}; use None, "balanced" or a dict')
        return kept * torch.where(signs < 0, each[:, :1], each[:, 1:])

    def own_state(self, gram: Gram, targets: Targets, found: State) -> dict[str, Tensor]:
        """See `KernelMachine.own_state`: Platt's curve, from decision values of held-out folds."""
        assert targets.classes is not None  # noqa: S101
        generator = inputs.generator_of(self.seed)
        platt = torch.full((2,), torch.nan, dtype=torch.float64)
        if self.probability:
            folds = fold_numbers(self.folds, targets, generator)
            masks = training_masks(folds).to(gram.rows.device)
            held = self.problems(targets, masks)
            parts = solve(gram, held, start_at(gram, held, found.beta.expand(len(masks), -1)))
            values = parts.product + parts.bias[:, None]
            decision = values.gather(0, folds.to(values.device)[None])[0]
            platt = torch.stack(fit_platt(decision, targets.y[0]))
        return {"classes": targets.classes, "platt": platt}

    def learn_on(self, x: Any, y: Any) -> Self:
        """See `KernelMachine.learn_on`; the curve from decision values to probabilities stays.

        It belongs to the hyper-parameters, and fitting it anew would cost five times as much.
        """
        platt = self.platt
        super().learn_on(x, y)
        self.platt = platt
        return self

    def decision_function(self, x: Any) -> Any:
        """Signed decision values (...), positive for the second class."""
        with torch.no_grad():
            return inputs.as_given(self.values(self._asked(x))[..., 0], x)

    def predict(self, x: Any) -> Any:
        """The class (...) on whose side of the decision boundary each row lies."""
        with torch.no_grad():
            second = self.values(self._asked(x))[..., 0] > 0
            return inputs.as_given(self.classes[second.long()], x)

    def predict_proba(self, x: Any) -> Any:
        """Probabilities (..., 2) of the two classes, of which `forward` gives the second."""
        with torch.no_grad():
            second = self(self._asked(x))
            return inputs.as_given(torch.stack([1 - second, second], dim=-1), x)

    def score(self, x: Any, y: Any) -> float:
        """Share of rows x (n, d) whose class in y (n,) is predicted."""
        labels = inputs.as_tensor(y, "y")
        return float((inputs.as_tensor(self.predict(x), "y").to(labels) == labels).double().mean())

    def forward(self, x: Tensor) -> Tensor:
        """Probability (...) of the second class for rows x (..., d), differentiable in x.

        On a GPU nothing waits to see whether there are probabilities: they are NaN where not.

        Raises:
            ModelError: Not fitted, or fitted without `probability=True`.
            DataError: Wrong shape.
        """
        decision = self.values(x)[..., 0]
        if self.platt.is_cpu and not bool(torch.isfinite(self.platt).all()):
            raise ModelError("this SVC has no probabilities; fit it with probability=True")
        return probability(decision, self.platt[0], self.platt[1])
