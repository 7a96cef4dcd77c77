"""C-SVC for two classes, with Platt probabilities."""

from typing import Any, Self

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError, ModelError, SettingsError
from cgtorch.svm import inputs
from cgtorch.svm.folds import given_folds, stratified_folds, training_masks
from cgtorch.svm.gram import Gram
from cgtorch.svm.kernels import Kernel
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.optimality import duality_gap
from cgtorch.svm.platt import fit_platt, probability
from cgtorch.svm.problems import Problems, State, classification
from cgtorch.svm.solver import solve, start_at

ClassWeight = str | dict[float, float] | None


def row_weights(signs: Tensor, classes: Tensor, weight: ClassWeight, mask: Tensor) -> Tensor:
    """Weights (P, n) of rows with labels `signs` (n,), 0 where `mask` (P, n) leaves them out.

    "balanced" weighs a class by rows / (2 rows of the class) among the rows of the mask.

    Raises:
        SettingsError: The weight is neither None, "balanced" nor a positive weight per class.
        DataError: A mask leaves one class only.
    """
    kept = mask.to(signs)
    count = torch.stack([(kept * (signs < 0)).sum(1), (kept * (signs > 0)).sum(1)], dim=1)
    if bool((count == 0).any()):
        raise DataError("a training fold holds one class only; use fewer or stratified folds")
    if weight is None:
        return kept
    if weight == "balanced":
        each = count.sum(1, keepdim=True) / (2 * count)
    elif isinstance(weight, dict):
        unknown = [c for c in weight if c not in classes.tolist()]
        if unknown:
            raise SettingsError(f"class_weight has {unknown[0]!r:.40}, which is no label in y")
        pair = [inputs.positive(weight.get(c, 1.0), "class_weight") for c in classes.tolist()]
        each = torch.tensor(pair, dtype=torch.float64).to(signs).expand(len(kept), 2)
    else:
        raise SettingsError(f'class_weight is {weight!r}; use None, "balanced" or a dict')
    return kept * torch.where(signs < 0, each[:, :1], each[:, 1:])


class SVC(KernelMachine):
    """Support vector classifier for two classes, the problem of libsvm's C-SVC.

    The constructor only stores its arguments (scikit-learn's convention). Besides the buffers of
    `KernelMachine` the fitted state is `classes` (2,) and the Platt parameters `platt` (2,).

    Args:
        C: Cost of a violated margin.
        kernel: "rbf", "linear", "poly" or a callable (m, d), (n, d) -> (m, n).
        gamma: Width parameter of "rbf" and "poly": "scale", "auto" or a positive number.
        degree: Degree of "poly".
        coef0: Constant of "poly".
        class_weight: None, "balanced", or a factor on C per class.
        probability: Fit Platt probabilities by cross-validation.
        folds: Number of stratified folds for them, or fold numbers (n,), or (train, test) pairs.
        seed: Seed or generator of the folds.
        max_memory: Bytes that kernel matrices may take.
    """

    classes: Tensor
    platt: Tensor

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
        super().__init__()
        self.C = C
        self.kernel, self.gamma, self.degree, self.coef0 = kernel, gamma, degree, coef0
        self.class_weight, self.probability = class_weight, probability
        self.folds, self.seed, self.max_memory = folds, seed, max_memory
        self.register_buffer("classes", torch.tensor([0.0, 1.0], dtype=torch.float64))
        self.register_buffer("platt", torch.full((2,), torch.nan, dtype=torch.float64))

    @property
    def classes_(self) -> Tensor:
        """The two labels (2,), ascending."""
        self._check_fitted()
        return self.classes

    def fit(self, x: Any, y: Any, *, warm: bool = False) -> Self:
        """Solve the dual problem on rows x (n, d) with labels y (n,).

        With `warm`, the solver starts from the last fit, whose rows have to come first in x.

        Raises:
            DataError: Wrong shapes, NaN, not two classes, too few rows for the folds, or more
                rows than `max_memory` allows.
            SettingsError: A parameter cannot be used.
        """
        cap = inputs.positive(self.C, "C")
        rows = inputs.as_rows(x)
        classes, signs = inputs.as_binary(y, len(rows))
        signs = signs.to(rows)
        generator = inputs.generator_of(self.seed)
        gram = self._gram(rows)
        everything = torch.ones(1, len(rows), dtype=torch.bool, device=rows.device)
        caps = torch.tensor([cap], dtype=torch.float64).to(rows)
        problem = classification(
            signs, caps, row_weights(signs, classes, self.class_weight, everything)
        )
        found = solve(gram, problem, self._start(gram, problem, caps / cap) if warm else None)
        platt = torch.full((2,), torch.nan, dtype=torch.float64, device=rows.device)
        if self.probability:
            platt = self._platt(gram, signs, classes, problem, found, generator)
        self._keep(rows, found.beta, found.bias, duality_gap(problem, found), gram.gamma)
        self.cost = caps
        self.classes, self.platt = classes.to(rows), platt
        return self

    def _platt(
        self,
        gram: Gram,
        signs: Tensor,
        classes: Tensor,
        problem: Problems,
        found: State,
        generator: torch.Generator,
    ) -> Tensor:
        """Platt slope and offset (2,) from the decision values of held-out folds."""
        if isinstance(self.folds, int):
            folds = stratified_folds(signs, self.folds, generator)
        else:
            folds = given_folds(self.folds, len(signs))
        masks = training_masks(folds).to(signs.device)
        count = len(masks)
        weight = row_weights(signs, classes, self.class_weight, masks)
        held = classification(signs, problem.cap.expand(count).contiguous(), weight)
        parts = solve(gram, held, start_at(gram, held, found.beta.expand(count, -1)))
        values = parts.product + parts.bias[:, None]
        decision = values[folds.to(signs.device), torch.arange(len(signs), device=signs.device)]
        return torch.stack(fit_platt(decision, signs))

    def decision_function(self, x: Any) -> Any:
        """Signed decision values (...), positive for the second class.

        Raises:
            ModelError: Not fitted.
            DataError: Wrong shape.
        """
        with torch.no_grad():
            return inputs.as_given(self.values(self._asked(x))[..., 0], x)

    def predict(self, x: Any) -> Any:
        """The class (...) on whose side of the decision boundary each row lies."""
        with torch.no_grad():
            second = self.values(self._asked(x))[..., 0] > 0
            return inputs.as_given(self.classes[second.long()], x)

    def predict_proba(self, x: Any) -> Any:
        """Probabilities (..., 2) of the two classes.

        Raises:
            ModelError: Not fitted, or fitted without `probability=True`.
        """
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
