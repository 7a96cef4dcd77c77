"""What SVC and SVR share: the fit, centres, weights and bias as buffers, and the values they give.

A classifier is a regression of signs without a tube, in which a coefficient can only have the sign
of its row; so the two differ in their targets, the weights of rows, and what they say of values.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self, TypeAlias

import torch
from torch import Tensor, nn

from cgtorch.ground.errors import DataError, ModelError
from cgtorch.native import suits, threads
from cgtorch.svm import inputs
from cgtorch.svm.compiled import LOG2E, machine_values
from cgtorch.svm.gram import Gram, resolve_gamma
from cgtorch.svm.problems import Problems, State, Targets, duality_gap
from cgtorch.svm.rbf_predict import predict_rbf
from cgtorch.svm.solver import solve, start_at

PerOutput: TypeAlias = float | Sequence[float]
"""A number, or one for each."""


class FittedModule(nn.Module):
    """A module whose buffers take their sizes from a state dict, as a fit does from its data."""

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
    `gamma_value` (), `support` (m,) the training rows that are centres, `gap` (k,) the duality
    gap of each output, `cost` (k,) its C, and what a subclass adds. Before `fit` they are empty.

    Args:
        C: Cost of a violation, one or one per output.
        epsilon: Half width of the tube without loss, one or one per output.
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
    """The score, of `cgtorch.svm.scores`, by which models are compared if no other is named."""

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
        """What is to be learnt of rows (n, d)."""

    @abstractmethod
    def own_state(self, targets: Targets) -> dict[str, Tensor]:
        """The buffers that a subclass adds, after a fit."""

    @property
    def fitted(self) -> bool:
        """Whether there is something to predict with."""
        return len(self.centres) > 0

    def fit(self, x: Any, y: Any, *, warm: bool = False) -> Self:
        """Solve the dual problems on rows x (n, d) with labels y (n,), or targets (n,) or (n, k).

        With `warm`, the solver starts from the last fit, whose rows have to come first in x.
        DataError for wrong shapes, NaN, not two classes, or more rows than there is memory for, and
        SettingsError for a parameter that cannot be used.
        """
        rows = self.training_rows(x)
        targets = self.targets(y, rows)
        everything = torch.ones(1, len(rows), dtype=torch.bool, device=rows.device)
        problems = self.problems(targets, everything)
        gram, unit = self.gram(rows), targets.unit
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

    def learn_on(self, x: Any, y: Any) -> Self:
        """`fit`, warm, with the C, epsilon and gamma of the last fit, whoever made it."""
        self.C, self.gamma = self.cost.tolist(), float(self.gamma_value)
        return self.fit(x, y, warm=True)

    def training_rows(self, x: Any) -> Tensor:
        """Rows (n, d) in float64 that are finite and not too many for the memory."""
        rows = inputs.as_rows(x)
        inputs.check_memory(len(rows))
        return rows

    def gram(self, rows: Tensor, gamma: float | None = None, most_threads: int = 0) -> Gram:
        """The kernel values among training rows (n, d), if given with another gamma or threads."""
        width = resolve_gamma(self.gamma if gamma is None else gamma, rows)
        return Gram(rows, width, most_threads or threads())

    def problems(
        self, targets: Targets, masks: Tensor, C: Any = None, epsilon: Any = None
    ) -> Problems:
        """Problems (k P) of each output and mask (P, n); the machine's C and epsilon if None."""
        outputs, unit = len(targets.z), targets.unit
        C, epsilon = self.C if C is None else C, self.epsilon if epsilon is None else epsilon
        cap = inputs.per_output(C, "C", outputs).to(unit) / unit
        tube = inputs.per_output(epsilon, "epsilon", outputs, inputs.not_negative).to(unit)
        cap, tube = (x.repeat_interleave(len(masks)) for x in (cap, tube / unit))
        z, width = (
            targets.z.repeat_interleave(len(masks), 0),
            cap[:, None] * masks.repeat(outputs, 1),
        )
        if targets.classes is None:
            return Problems(z, -width, width, tube, cap)
        down, up = width * (z < 0), width * (z > 0)
        if bool((torch.minimum(down.amax(1), up.amax(1)) == 0).any()):
            raise DataError("a training fold holds one class only; use fewer or stratified folds")
        return Problems(z, -down, up, tube, cap)

    def values(self, x: Tensor) -> Tensor:
        """Values (..., k) of rows x (..., d), in the type of the buffers.

        ModelError if not fitted, DataError for another number of features.
        """
        return self._values(x, with_nearest=False)[0]

    def values_and_distance(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Values (..., k) and the squared distance (...) to the nearest centre, in one go."""
        values, exponent = self._values(x, with_nearest=True)
        distance = exponent.clamp_min(0) / (self.gamma_value * LOG2E)
        return values, distance.reshape(x.shape[:-1])

    def _values(self, x: Tensor, with_nearest: bool) -> tuple[Tensor, Tensor]:
        """Values (..., k) of x (..., d), and γ |x - c|² log2(e) (n,) of the nearest centres."""
        self._check_fitted()
        features = self.centres.shape[1]
        if x.shape[-1:] != (features,):
            given = x.shape[-1] if x.ndim else "no"
            raise DataError(f"a row has {given} features; the model was fitted on {features}")
        rows = x.reshape(-1, features).to(self.centres)
        compiled = machine_values(rows, *self._machine) if suits(rows, *self._machine) else None
        values, nearest = compiled or predict_rbf(rows, *self._machine, with_nearest)
        return values.reshape(*x.shape[:-1], values.shape[1]), nearest

    @property
    def _machine(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.centres, self.weights, self.bias, self.gamma_value

    def _check_fitted(self) -> None:
        if not self.fitted:
            raise ModelError(
                f"this {type(self).__name__} has not been fitted; call fit(x, y) first"
            )

    def _asked(self, x: Any) -> Tensor:
        """What a prediction is asked for: tensors as they are, all else checked and converted."""
        self._check_fitted()
        return x if isinstance(x, Tensor) else inputs.as_tensor(x, "x").to(self.centres)

    def _start(self, gram: Gram, problems: Problems, unit: Tensor) -> State:
        """This machine as a start for a new fit, whose first rows are those it was fitted on."""
        self._check_fitted()
        if len(self.bias) != len(problems.z) or int(self.support.max()) >= len(gram):
            raise DataError(
                f"{len(gram)} rows with {len(problems.z)} outputs do not begin with those of the "
                "last fit; pass all known rows first, in their order, and the new ones after them"
            )
        beta = torch.zeros_like(problems.z)
        beta[:, self.support] = self.weights.T.to(beta) / unit[:, None]
        return start_at(gram, problems, beta)
