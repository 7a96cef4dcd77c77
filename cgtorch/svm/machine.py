"""What SVC and SVR share: centres, weights and bias as buffers, and the values they give."""

import inspect
from collections.abc import Mapping
from typing import Any, Self

import torch
from torch import Tensor, nn

from cgtorch.ground.errors import DataError, ModelError, SettingsError
from cgtorch.native import threads
from cgtorch.native.structures import suits
from cgtorch.svm import inputs
from cgtorch.svm.compiled import machine_values
from cgtorch.svm.gram import Gram
from cgtorch.svm.kernels import Kernel, make_kernel, resolve_gamma
from cgtorch.svm.problems import Problems, State
from cgtorch.svm.rbf_predict import LOG2E, chunk_rows, fused_rbf, fused_rbf_and_nearest
from cgtorch.svm.solver import start_at


class KernelMachine(nn.Module):
    """A function sum_j w_j K(x, c_j) + b with k outputs.

    The buffers are the whole fitted state: `centres` (m, d), `weights` (m, k), `bias` (k,),
    `gamma_value` (), `support` (m,) the training rows that are centres, `gap` (k,) the duality
    gap of each output, `cost` (k,) its C, and what a subclass adds. Before `fit` they are empty.
    """

    centres: Tensor
    weights: Tensor
    bias: Tensor
    gamma_value: Tensor
    support: Tensor
    gap: Tensor
    cost: Tensor

    kernel: str | Kernel
    gamma: str | float
    degree: int
    coef0: float
    max_memory: int

    def __init__(self) -> None:
        super().__init__()
        shapes = {"centres": (0, 0), "weights": (0, 1), "bias": (1,), "gap": (1,), "cost": (1,)}
        for name, shape in shapes.items():
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("gamma_value", torch.ones((), dtype=torch.float64))
        self.register_buffer("support", torch.zeros(0, dtype=torch.long))

    @property
    def fitted(self) -> bool:
        """Whether there is something to predict with."""
        return len(self.centres) > 0

    @property
    def n_features_in_(self) -> int:
        """Number of features d of a row."""
        self._check_fitted()
        return self.centres.shape[1]

    @property
    def support_(self) -> Tensor:
        """Training rows that are centres (m,), ascending."""
        self._check_fitted()
        return self.support

    @property
    def support_vectors_(self) -> Tensor:
        """The centres (m, d)."""
        self._check_fitted()
        return self.centres

    @property
    def dual_coef_(self) -> Tensor:
        """Weights of the centres (k, m)."""
        self._check_fitted()
        return self.weights.T

    @property
    def intercept_(self) -> Tensor:
        """Biases (k,)."""
        self._check_fitted()
        return self.bias

    def values(self, x: Tensor) -> Tensor:
        """Values (..., k) of rows x (..., d), in the type of the buffers.

        Raises:
            ModelError: Not fitted.
            DataError: Another number of features.
        """
        rows = self._rows(x)
        if (found := self._compiled(rows)) is not None:
            values = found[0]
        else:
            values = fused_rbf(rows, *self._machine) if self.kernel == "rbf" else self._plain(rows)
        return values.reshape(*x.shape[:-1], values.shape[1])

    def values_and_distance(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Values (..., k), and for an RBF kernel the squared distance (...) to the nearest centre.

        Both come from the same kernel evaluation. For other kernels the distance is 0.

        Raises:
            ModelError: Not fitted.
            DataError: Another number of features.
        """
        rows = self._rows(x)
        if self.kernel == "rbf":
            found = self._compiled(rows)
            values, exponent = found or fused_rbf_and_nearest(rows, *self._machine)
            distance = exponent.clamp_min(0) / (self.gamma_value * LOG2E)
        else:
            values, distance = self._plain(rows), rows.new_zeros(len(rows))
        lead = x.shape[:-1]
        return values.reshape(*lead, values.shape[1]), distance.reshape(lead)

    def _compiled(self, rows: Tensor) -> tuple[Tensor, Tensor] | None:
        """What compiled code says of rows (n, d) where there is some and no gradient is asked."""
        if self.kernel != "rbf" or not suits(rows, *self._machine):
            return None
        return machine_values(rows, *self._machine)

    @property
    def _machine(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.centres, self.weights, self.bias, self.gamma_value

    def _rows(self, x: Tensor) -> Tensor:
        """Rows (n, d) of x (..., d), in the type of the buffers.

        Raises:
            ModelError: Not fitted.
            DataError: Another number of features.
        """
        self._check_fitted()
        features = self.centres.shape[1]
        if x.shape[-1:] != (features,):
            given = x.shape[-1] if x.ndim else "no"
            raise DataError(f"a row has {given} features; the model was fitted on {features}")
        return x.reshape(-1, x.shape[-1]).to(self.centres)

    def _plain(self, rows: Tensor) -> Tensor:
        """Values (n, k) with any kernel, in chunks of bounded memory."""
        kernel = make_kernel(self.kernel, float(self.gamma_value), self.degree, self.coef0)
        size = chunk_rows(len(self.centres), rows.element_size())
        parts = [kernel(part, self.centres) @ self.weights for part in rows.split(size)]
        return torch.cat(parts) + self.bias

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The constructor's arguments by name, as scikit-learn's `clone` wants them."""
        del deep
        names = inspect.signature(type(self).__init__).parameters
        return {name: getattr(self, name) for name in names if name != "self"}

    def set_params(self, **params: Any) -> Self:
        """Change constructor arguments by name; the next `fit` uses them.

        Raises:
            SettingsError: A name the constructor does not have.
        """
        known = self.get_params()
        for name, value in params.items():
            if name not in known:
                raise SettingsError(f"{name!r} is no parameter; choose among {sorted(known)}")
            setattr(self, name, value)
        return self

    def _check_fitted(self) -> None:
        if not self.fitted:
            raise ModelError(
                f"this {type(self).__name__} has not been fitted; call fit(x, y) first"
            )

    def _asked(self, x: Any) -> Tensor:
        """What a prediction is asked for: tensors as they are, all else checked and converted.

        Raises:
            ModelError: Not fitted.
            DataError: Not numbers, or not all finite.
        """
        self._check_fitted()
        return x if isinstance(x, Tensor) else inputs.as_tensor(x, "x").to(self.centres)

    def _gram(self, rows: Tensor) -> Gram:
        """The kernel values among training rows (n, d).

        Raises:
            DataError: They take more than `max_memory`.
            SettingsError: The kernel or one of its parameters cannot be used.
        """
        inputs.check_memory(len(rows), self.max_memory)
        gamma = resolve_gamma(self.gamma, rows)
        return Gram(self.kernel, rows, gamma, self.degree, self.coef0, threads())

    def _start(self, gram: Gram, problems: Problems, unit: Tensor) -> State:
        """This machine as a start for a new fit.

        The rows that it was fitted on have to come first among the rows of the new fit, whose
        targets were divided by `unit` (k,).

        Raises:
            DataError: There are fewer rows than it was fitted on.
        """
        self._check_fitted()
        if len(self.bias) != len(problems.z) or int(self.support.max()) >= len(gram):
            raise DataError(
                f"{len(gram)} rows with {len(problems.z)} outputs do not begin with those of the "
                "last fit; pass all known rows first, in their order, and the new ones after them"
            )
        beta = torch.zeros_like(problems.z)
        beta[:, self.support] = self.weights.T.to(beta) / unit[:, None]
        return start_at(gram, problems, beta)

    def _keep(self, x: Tensor, beta: Tensor, bias: Tensor, gap: Tensor, gamma: float) -> None:
        """Store the rows of x (n, d) that any of the k machines `beta` (k, n) uses."""
        used = (beta != 0).any(0)
        if not bool(used.any()):
            used[0] = True  # a constant still needs a centre to say how many features a row has
        self.support = used.nonzero().flatten()
        self.centres, self.weights = x[used].clone(), beta[:, used].T.contiguous()
        self.bias, self.gap = bias.clone(), gap.clone()
        self.gamma_value = torch.tensor(gamma, dtype=x.dtype, device=x.device)

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        """Take the buffers' sizes from the state dict, as a fit does from its data."""
        for name, buffer in self._buffers.items():
            given = state_dict.get(prefix + name)
            if isinstance(given, Tensor) and buffer is not None and given.shape != buffer.shape:
                self._buffers[name] = buffer.new_zeros(given.shape)
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)
