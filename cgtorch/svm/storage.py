"""Models on disk: safetensors with a JSON header, never pickle, written all or not at all."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

import torch
from safetensors.torch import save
from torch import Tensor, nn

from cgtorch.ground.errors import ModelError
from cgtorch.ground.files import notes_of, read_bytes, tensors_of, write_bytes
from cgtorch.svm.svc import SVC
from cgtorch.svm.svr import SVR

VERSION = 3
Kinds: TypeAlias = Mapping[str, Callable[[], nn.Module]]
MAX_BYTES = 1024**3
"""Largest model file that `load_model` reads."""

_POSITIVE = ("gamma_value", "scale", "spread", "reach")

MACHINES: Kinds = {"SVC": SVC, "SVR": SVR}
"""What makes an unfitted machine, by the name of its class."""
_MACHINE_SETTINGS = ("kernel", "degree", "coef0")


@runtime_checkable
class Wrapped(Protocol):
    """A model around a machine, such as Γ and C: a `torch.nn.Module` with buffers of its own."""

    machine: SVC | SVR

    def shapes(self, features: int) -> dict[str, tuple[int, ...]]:
        """The shapes of its own buffers, given the machine's number of features."""
        ...


Model: TypeAlias = nn.Module
"""An `SVC`, an `SVR`, or a `Wrapped` one."""


def _machine(model: Model) -> SVC | SVR:
    if isinstance(model, SVC | SVR):
        return model
    assert isinstance(model, Wrapped)  # noqa: S101  nothing else is made here
    return model.machine


def save_model(path: str | Path, model: Model, report: Any = None) -> None:
    """Write a fitted model, and the report of its fit if given, to one file.

    Args:
        path: The file, replaced only when all of the new one is on disk.
        model: A fitted `SVC` or `SVR`, or a model around one such as Γ or C.
        report: A dataclass or JSON value to keep with it.

    Raises:
        ModelError: The model is not fitted, its kernel is a callable, or the file cannot be
            written.
    """
    kind = type(model).__name__
    machine = _machine(model)
    machine._check_fitted()
    if not isinstance(machine.kernel, str):
        raise ModelError("a model with a callable kernel cannot be saved; use a named kernel")
    settings = {name: getattr(machine, name) for name in _MACHINE_SETTINGS}
    header = {
        "format": "cgtorch-model",
        "version": VERSION,
        "kind": kind,
        "settings": settings,
        "report": asdict(report)
        if is_dataclass(report) and not isinstance(report, type)
        else report,
    }
    state = {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()}
    data = save(state, metadata={"cgtorch": json.dumps(header)})
    write_bytes(path, data, ModelError)


def load_model(path: str | Path, kinds: Kinds = MACHINES) -> Model:
    """Read a model that `save_model` wrote, in evaluation mode.

    Args:
        path: The file.
        kinds: What makes an unfitted model, by the name of its class; machines if not given.

    Raises:
        ModelError: The file is missing, damaged, of another version, too large, or no model.
    """
    return load_model_and_report(path, kinds)[0]


def load_report(path: str | Path, kinds: Kinds = MACHINES) -> Any:
    """The report stored with a model, as plain JSON values, or None.

    Raises:
        ModelError: As for `load_model`.
    """
    return load_model_and_report(path, kinds)[1]


def load_model_and_report(path: str | Path, kinds: Kinds = MACHINES) -> tuple[Model, Any]:
    """`load_model` and `load_report` from one reading of the file.

    Raises:
        ModelError: As for `load_model`.
    """
    path = Path(path)
    data = read_bytes(path, MAX_BYTES, ModelError)
    try:
        state = tensors_of(data)
        header = _header(path, notes_of(data).get("cgtorch"), kinds)
    except (ValueError, TypeError, KeyError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"model file {path} is damaged: {error}") from error
    model = kinds[header["kind"]]()
    _machine(model).set_params(**header["settings"])
    _check(path, model, state)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise ModelError(f"model file {path} does not hold a whole {header['kind']}") from error
    return model.to(_machine_type(model, state)).eval(), header.get("report")


def _machine_type(model: Model, state: dict[str, Tensor]) -> torch.dtype:
    prefix = "" if _machine(model) is model else "machine."
    return state[prefix + "centres"].dtype


def _header(path: Path, text: str | None, kinds: Kinds) -> dict[str, Any]:
    """The checked JSON header.

    Raises:
        ModelError: It is missing or wrong.
    """
    try:
        header = json.loads(text or "")
    except (ValueError, TypeError, RecursionError) as error:
        raise ModelError(f"{path} is no cgtorch model: it has no readable header") from error
    if not isinstance(header, dict) or header.get("format") != "cgtorch-model":
        raise ModelError(f"{path} is no cgtorch model")
    if header.get("version") != VERSION:
        raise ModelError(
            f"model file {path} has version {header.get('version')!r}; this cgtorch reads {VERSION}"
        )
    settings = header.get("settings")
    if header.get("kind") not in kinds or not isinstance(settings, dict):
        raise ModelError(f"model file {path} holds an unknown model {header.get('kind')!r}")
    good = (
        set(settings) == set(_MACHINE_SETTINGS)
        and settings["kernel"] in ("rbf", "linear", "poly")
        and type(settings["degree"]) is int
        and 0 <= settings["degree"] <= 100
        and type(settings["coef0"]) in (int, float)
        and abs(settings["coef0"]) < 1e100
    )
    if not good:
        raise ModelError(f"model file {path} has unusable settings {settings!r:.200}")
    return header


def _check(path: Path, model: Model, state: dict[str, Tensor]) -> None:
    """Refuse tensors that do not fit together.

    Raises:
        ModelError: A tensor is missing, of another type or shape, or not finite.
    """
    expected = model.state_dict()
    if set(expected) != set(state):
        odd = sorted(set(expected) ^ set(state))[:3]
        raise ModelError(f"model file {path} has missing or unknown tensors: {', '.join(odd)}")
    prefix = "" if _machine(model) is model else "machine."
    for name, value in state.items():
        floating = expected[name].is_floating_point()
        if value.is_floating_point() != floating or (
            floating and value.dtype not in (torch.float32, torch.float64)
        ):
            raise ModelError(f"model file {path}: {name} has type {value.dtype}")
        if not floating and value.dtype != expected[name].dtype:
            raise ModelError(f"model file {path}: {name} has type {value.dtype}")
        if (
            floating
            and name.split(".")[-1] not in ("platt", "gap")
            and not bool(torch.isfinite(value).all())
        ):
            raise ModelError(f"model file {path}: {name} has NaN or infinite values")
        if value.ndim != expected[name].ndim:
            raise ModelError(f"model file {path}: {name} has shape {tuple(value.shape)}")
        last = name.split(".")[-1]
        if (last in _POSITIVE and not bool((value > 0).all())) or (
            last == "support" and not bool((value >= 0).all())
        ):
            raise ModelError(f"model file {path}: {name} has values that it cannot have")
    m, d = state[prefix + "centres"].shape
    k = state[prefix + "bias"].shape[0]
    shapes: dict[str, tuple[int, ...]] = {
        "weights": (m, k), "gap": (k,), "cost": (k,), "tube": (k,),
        "support": (m,), "classes": (2,), "platt": (2,),
    }  # fmt: skip
    outer = {} if isinstance(model, SVC | SVR) else model.shapes(d)  # type: ignore[operator]
    wrong = [n for n, s in shapes.items() if prefix + n in state and state[prefix + n].shape != s]
    wrong += [n for n, s in outer.items() if state[n].shape != s]
    if wrong or 0 in (m, d, k) or (k > 1 and isinstance(_machine(model), SVC)):
        raise ModelError(f"model file {path}: {', '.join(wrong) or 'centres'} of a wrong shape")
