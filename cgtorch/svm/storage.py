"""Models on disk: safetensors with a JSON header, never pickle, written whole or not at all."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, TypeAlias

import torch
from safetensors.torch import save
from torch import Tensor, nn

from cgtorch.ground.errors import ModelError
from cgtorch.ground.files import notes_of, read_bytes, tensors_of, write_bytes
from cgtorch.svm.machine import SVC, SVR, KernelMachine

VERSION = 3
MAX_BYTES = 1024**3
"""The size of the largest model file that `load_model` reads."""

Model: TypeAlias = nn.Module
"""A machine, or a model around one, such as Γ and C. The latter has the machine as `machine`, its
own buffers, and a method `shapes(features)` that gives their shapes by name."""
Kinds: TypeAlias = Mapping[str, Callable[[], Model]]
MACHINES: Kinds = {"SVC": SVC, "SVR": SVR}
"""Functions that make unfitted machines, by class name."""

_SETTINGS = {"kernel": "rbf", "degree": 3, "coef0": 0.0}
"""The kernel settings in every file; machines with other ones cannot be read."""
_POSITIVE = ("gamma_value", "scale", "spread", "reach")
_MAY_BE_INFINITE = ("platt", "gap")


def _machine(model: Model) -> tuple[str, KernelMachine]:
    """The prefix of the names of a machine's buffers in a model, and the machine."""
    if isinstance(model, KernelMachine):
        return "", model
    assert isinstance(model.machine, KernelMachine)  # noqa: S101  nothing else is made here
    return "machine.", model.machine


def save_model(path: str | Path, model: Model, report: Any = None) -> None:
    """Write a model and a report of its fit, a dataclass or JSON value, to one file.

    An existing file is replaced only when the new one is complete. ModelError if it cannot be
    written, or the model is not fitted.
    """
    _machine(model)[1].check_fitted()
    if is_dataclass(report) and not isinstance(report, type):
        report = asdict(report)
    header = {"format": "cgtorch-model", "version": VERSION, "kind": type(model).__name__}
    header |= {"settings": _SETTINGS, "report": report}
    state = {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()}
    data = save(state, metadata={"cgtorch": json.dumps(header)})
    write_bytes(path, data, ModelError)


def load_model(path: str | Path, kinds: Kinds = MACHINES) -> Model:
    """The model in a file; see `load_model_and_report`."""
    return load_model_and_report(path, kinds)[0]


def load_model_and_report(path: str | Path, kinds: Kinds = MACHINES) -> tuple[Model, Any]:
    """Read a file of `save_model`: the model, in evaluation mode, and the report as JSON values.

    `kinds` are functions that make unfitted models, by class name; by default those of machines.
    ModelError if the file is missing, damaged, of another version, too large, or no model.
    """
    path = Path(path)
    data = read_bytes(path, MAX_BYTES, ModelError)
    try:
        return _loaded(path, data, kinds)
    except ModelError as error:
        raise ModelError(f"{error}; restore the file") from error


def _loaded(path: Path, data: bytes, kinds: Kinds) -> tuple[Model, Any]:
    """The model and report in the data of a file."""
    try:
        state = tensors_of(data)
        header = _header(path, notes_of(data).get("cgtorch"), kinds)
    except (ValueError, TypeError, KeyError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"model file {str(path)!r} is damaged: {error}") from error
    model = kinds[header["kind"]]()
    _check(path, model, state)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise ModelError(
            f"model file {str(path)!r} does not hold a whole {header['kind']}"
        ) from error
    return model.to(state[f"{_machine(model)[0]}centres"].dtype).eval(), header.get("report")


def _header(path: Path, text: str | None, kinds: Kinds) -> dict[str, Any]:
    """The checked JSON header."""
    try:
        header = json.loads(text or "")
    except (ValueError, TypeError, RecursionError) as error:
        raise ModelError(f"{str(path)!r} is no cgtorch model: it has no readable header") from error
    if not isinstance(header, dict) or header.get("format") != "cgtorch-model":
        raise ModelError(f"{str(path)!r} is no cgtorch model")
    if header.get("version") != VERSION:
        raise ModelError(
            f"model file {str(path)!r} has version {header.get('version')!r}; this cgtorch reads "
            f"{VERSION}"
        )
    if header.get("kind") not in kinds:
        raise ModelError(f"model file {str(path)!r} holds an unknown model {header.get('kind')!r}")
    if header.get("settings") != _SETTINGS:
        raise ModelError(
            f"model file {str(path)!r} has unusable settings {header.get('settings')!r:.200}"
        )
    return header


def _check(path: Path, model: Model, state: dict[str, Tensor]) -> None:
    """Refuse tensors that are missing, of another type or shape, or do not fit together."""
    expected = model.state_dict()
    if set(expected) != set(state):
        odd = sorted(set(expected) ^ set(state))[:3]
        raise ModelError(
            f"model file {str(path)!r} has missing or unknown tensors: {', '.join(odd)}"
        )
    for name, value in state.items():
        wrong = _wrong(name.split(".")[-1], value, expected[name])
        if wrong:
            raise ModelError(f"model file {str(path)!r}: {name} has {wrong}")
    place, machine = _machine(model)
    (m, d), (k,) = (state[f"{place}{name}"].shape for name in ("centres", "bias"))
    inner: dict[str, tuple[int, ...]] = {
        "weights": (m, k), "gap": (k,), "cost": (k,), "tube": (k,),
        "support": (m,), "classes": (2,), "platt": (2,),
    }  # fmt: skip
    shapes = {f"{place}{name}": shape for name, shape in inner.items() if place + name in state}
    shapes |= {} if model is machine else model.shapes(d)  # type: ignore[operator]
    bad = [name for name, shape in shapes.items() if state[name].shape != shape]
    if bad or 0 in (m, d, k) or (k > 1 and isinstance(machine, SVC)):
        raise ModelError(
            f"model file {str(path)!r}: {', '.join(bad) or 'centres'} of a wrong shape"
        )


def _wrong(name: str, value: Tensor, expected: Tensor) -> str:
    """The fault of a single tensor, "" if there is none."""
    floating = expected.is_floating_point()
    if value.dtype not in ((torch.float32, torch.float64) if floating else (expected.dtype,)):
        return f"type {value.dtype}"
    if floating and name not in _MAY_BE_INFINITE and not bool(torch.isfinite(value).all()):
        return "NaN or infinite values"
    if value.ndim != expected.ndim:
        return f"shape {tuple(value.shape)}"
    low = (value <= 0) if name in _POSITIVE else (value < 0) & (name == "support")
    return "values that it cannot have" if bool(low.any()) else ""
