"""SVC and SVR, and their common base: the fit, the buffers, and the values.

A classifier is a regression of signs without a tube, in which a coefficient can only have the sign
of its row. So the two differ in their targets, the weights of rows, and the meaning of values.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Self, TypeAlias

import torch
from torch import Tensor, nn

from cgtorch.ground.errors import DataError, ModelError
from cgtorch.native import suits
from cgtorch.svm import inputs
from cgtorch.svm.platt import probability
from cgtorch.svm.problems import Problems, State, Targets, at_zero, duality_gap, feasible
from cgtorch.svm.rbf import LOG2E, Gram, machine_values, predict_rbf
from cgtorch.svm.solver import solve

PerOutput: TypeAlias = float | Sequence[float]
"""One number, or one per output."""


class FittedModule(nn.Module):
    """A module whose buffers take their sizes from a state dict, as they do from data in a fit."""

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        for name, buffer in self._buffers.items():
            given = state_dict.get(prefix + name)
            if isinstance(given, Tensor) and buffer is not None and given.ndim == buffer.ndim:
                self._buffers[name] = buffer.new_zeros(given.shape)
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)


class KernelMachine(FittedModule, ABC):
    """A function sum_j w_j exp(-gamma |x - c_j|^2) + b with k outputs.

    The buffers are the whole fitted state: `centres` (m, d), `weights` (m, k), `bias` (k,),
    `gamma_value` (), `support` (m,) the training rows that are centres, `gap` (k,) the duality gap
    of each output, `cost` (k,) its C, and those of a subclass. Before `fit` they are empty.

    Args:
        C: Cost of a violation, one number or one per output.
        epsilon: Half width of the tube without loss, one number or one per output.
        gamma: Width parameter of the kernel: "scale" or a positive number.
    """

    centres: Tensor
    weights: Tensor
    bias: Tensor
    gamma_value: Tensor
    support: Tensor
    gap: Tensor
    cost: Tensor

    scoring: ClassVar[str]
    """The default score, of `cgtorch.svm.cross_validation`, for comparing models."""

    def __init__(self, C: PerOutput, epsilon: PerOutput, gamma: str | float) -> None:
        super().__init__()
        self.C, self.epsilon, self.gamma = C, epsilon, gamma
        shapes = {"centres": (0, 0), "weights": (0, 1), "bias": (1,), "gap": (1,), "cost": (1,)}
        for name, shape in shapes.items():
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("gamma_value", torch.ones((), dtype=torch.float64))
        self.register_buffer("support", torch.zeros(0, dtype=torch.long))

    @abstractmethod
    def targets(self, y: Any, rows: Tensor) -> Targets:
        """The targets of rows (n, d)."""

    @abstractmethod
    def own_state(self, targets: Targets) -> dict[str, Tensor]:
        """The additional buffers of a subclass, after a fit."""

    @property
    def fitted(self) -> bool:
        """Whether the machine can predict."""
        return len(self.centres) > 0

    def fit(self, x: Any, y: Any, *, sample_weight: Any = None, warm: bool = False) -> Self:
        """Solve the dual problems on rows x (n, d) with labels y (n,), or targets (n,) or (n, k).

        A row of weight w (n,), at least 0, has the cost w C, as in libsvm; all weights are 1 if
        None. With `warm`, the solver starts from the last fit, whose rows have to come first in x.
        DataError for wrong shapes, NaN, not two classes, or more rows than there is memory for, and
        SettingsError for a parameter that cannot be used.
        """
        rows = inputs.training_rows(x)
        targets = self.targets(y, rows)
        weight = inputs.as_weights(sample_weight, len(rows)).to(rows.device)
        problems = self.problems(targets, weight[None])
        gram, unit = Gram(rows, self.gamma), targets.unit
        found = solve(gram, problems, self._start(gram, problems, unit) if warm else None)
        used = (found.beta != 0).any(0)
        if not bool(used.any()):
            used[0] = True  # a constant still needs a centre to say how many features a row has
        self.support, self.centres = used.nonzero().flatten(), rows[used].clone()
        self.weights = (found.beta * unit[:, None])[:, used].T.contiguous()
        self.bias, self.cost = found.bias * unit + targets.mean, problems.cap * unit
        self.gap = duality_gap(problems, found) * unit.square()
        self.gamma_value = torch.tensor(gram.gamma, dtype=rows.dtype, device=rows.device)
        for name, value in self.own_state(targets).items():
            setattr(self, name, value.to(rows.device))
        return self

    def learn_on(self, x: Any, y: Any, *, sample_weight: Any = None) -> Self:
        """A warm `fit` with the C, epsilon and gamma of the last fit."""
        self.C, self.gamma = self.cost.tolist(), float(self.gamma_value)
        return self.fit(x, y, sample_weight=sample_weight, warm=True)

    def problems(
        self, targets: Targets, weights: Tensor, C: Any = None, epsilon: Any = None
    ) -> Problems:
        """Problems (k P) for each output and weights (P, n) of rows, or masks of those in use.

        By default they have the machine's own C and epsilon.
        """
        outputs, unit = len(targets.z), targets.unit
        C, epsilon = self.C if C is None else C, self.epsilon if epsilon is None else epsilon
        cap = inputs.per_output(C, "C", outputs).to(unit) / unit
        tube = inputs.per_output(epsilon, "epsilon", outputs, or_zero=True).to(unit) / unit
        cap, tube, z = (x.repeat_interleave(len(weights), 0) for x in (cap, tube, targets.z))
        width = cap[:, None] * weights.repeat(outputs, 1)
        if targets.classes is None:
            return Problems(z, -width, width, tube, cap)
        down, up = width * (z < 0), width * (z > 0)
        if bool((torch.minimum(down.amax(1), up.amax(1)) == 0).any()):
            raise DataError(
                "the rows of a fit or training fold whose weight is not 0 hold one class only; use "
                "other weights, or fewer or stratified folds"
            )
        return Problems(z, -down, up, tube, cap)

    def values(self, x: Tensor) -> Tensor:
        """Values (..., k) of rows x (..., d), in the type of the buffers.

        ModelError if not fitted, DataError for another number of features.
        """
        return self._values(x, with_nearest=False)[0]

    def values_and_distance(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Values (..., k) and the squared distance (...) to the nearest centre, at once."""
        values, exponent = self._values(x, with_nearest=True)
        distance = exponent.clamp_min(0) / (self.gamma_value * LOG2E)
        return values, distance.reshape(x.shape[:-1])

    def _values(self, x: Tensor, with_nearest: bool) -> tuple[Tensor, Tensor]:
        """Values (..., k) of x (..., d), and γ |x - c|² log2(e) (n,) of the nearest centres."""
        self.check_fitted()
        features = self.centres.shape[1]
        if x.shape[-1:] != (features,):
            given = x.shape[-1] if x.ndim else "no"
            raise DataError(f"a row has {given} features; the model was fitted on {features}")
        rows = x.reshape(-1, features).to(self.centres)
        compiled = machine_values(rows, *self.tensors) if suits(rows, *self.tensors) else None
        values, nearest = compiled or predict_rbf(rows, *self.tensors, with_nearest)
        return values.reshape(*x.shape[:-1], values.shape[1]), nearest

    @property
    def tensors(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Centres (m, d), weights (m, k), bias (k,) and gamma (), as for `machine_structure`."""
        return self.centres, self.weights, self.bias, self.gamma_value

    def check_fitted(self) -> None:
        """ModelError before a fit."""
        if not self.fitted:
            name = type(self).__name__
            raise ModelError(f"this {name} has not been fitted; call fit(x, y) first")

    def _asked(self, x: Any) -> Tensor:
        """The input of a prediction: tensors as they are, anything else checked and converted."""
        self.check_fitted()
        return x if isinstance(x, Tensor) else inputs.as_tensor(x, "x").to(self.centres)

    def _start(self, gram: Gram, problems: Problems, unit: Tensor) -> State:
        """This machine as a start for a new fit, whose first rows are those of the last fit."""
        self.check_fitted()
        if len(self.bias) != len(problems.z) or int(self.support.max()) >= len(gram):
            raise DataError(
                f"{len(gram)} rows with {len(problems.z)} outputs do not begin with those of the "
                "last fit; pass all known rows first, in their order, and the new ones after them"
            )
        beta = torch.zeros_like(problems.z)
        beta[:, self.support] = self.weights.T.to(beta) / unit[:, None]
        beta = feasible(problems, beta)
        product = (beta.cpu() @ gram.matrix).to(beta)
        return replace(at_zero(problems), beta=beta, product=product)


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
        most = inputs.without_outliers(y)
        top = most.abs().amax(1, keepdim=True).clamp_min(1e-300)  # whose square may be infinite
        mean, spread = most.mean(1), (most / top).std(1, correction=0) * top[:, 0]
        unit = torch.exp2(spread.clamp_min(1e-300).log2().round())
        # Where all targets are equal, there is only rounding left.
        unit = torch.where(spread > 1e-12 * mean.abs(), unit, 1.0)
        return Targets(y, (y - mean[:, None]) / unit[:, None], mean, unit, None, given.ndim == 1)

    def own_state(self, targets: Targets) -> dict[str, Tensor]:
        """See `KernelMachine.own_state`."""
        tube = inputs.per_output(self.epsilon, "epsilon", len(targets.y), or_zero=True)
        return {"tube": tube, "squeeze": torch.tensor(targets.single)}

    def learn_on(self, x: Any, y: Any, *, sample_weight: Any = None) -> Self:
        """See `KernelMachine.learn_on`."""
        self.epsilon = self.tube.tolist()
        return super().learn_on(x, y, sample_weight=sample_weight)

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
