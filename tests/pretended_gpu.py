"""A device that is none: tensors that say they are on a GPU, and lie where all tensors lie.

What torch would refuse there is refused here: an operation on tensors of two devices. What would
make the host wait for the GPU is counted: copies from one to the other, reading a number, and
shapes that depend on numbers. So code can be run as on a GPU where there is none, except for its
speed and roundings.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode, resolve_name

GPU = torch.device("cuda", 0)
WAITS = {
    "item", "tolist", "__bool__", "__int__", "__float__", "__index__", "nonzero", "unique",
    "masked_select", "cpu", "numpy", "equal", "allclose", "is_nonzero", "argwhere",
    "bincount",
}  # fmt: skip
"""Functions that make the host wait, by name; `bincount` looks for the greatest number first."""
ATTRIBUTES = {"device": GPU, "is_cuda": True, "is_cpu": False}


class OnGPU(Tensor):
    """A tensor that says it is on a GPU."""


class PretendedGPU(TorchFunctionMode):
    """Makes a GPU of every mention of one.

    Attributes:
        waits: how often the host has waited, by the file and the function that made it.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()

    def __torch_function__(
        self,
        function: Callable[..., Any],
        types: Sequence[type],
        given: Sequence[Any] = (),
        named: Mapping[str, Any] | None = None,
    ) -> Any:
        named = dict(named or {})
        name = getattr(function, "__name__", "")
        if name == "__get__":
            attribute = (resolve_name(function) or "").split(".")[-2]
            if attribute in ATTRIBUTES and isinstance(given[0], OnGPU):
                return ATTRIBUTES[attribute]
        target = _taken_device(name, given, named)
        tensors = list(_tensors((given, named)))
        there = [t for t in tensors if isinstance(t, OnGPU)]
        if there and target is None:
            here = [t for t in tensors if not isinstance(t, OnGPU) and t.dim()]
            if name in ("__getitem__", "__setitem__"):  # an index may lie on either
                here = [t for t in here if t is given[0]]
            assert not here, f"{name} of tensors on two devices: {[t.shape for t in here]}"
        self._count(name, given, named, bool(there), target)
        if target is not None and name == "to":
            given = _without_device(given, named)
        plain = _mapped(lambda t: t.as_subclass(Tensor) if isinstance(t, OnGPU) else t)
        with torch._C.DisableTorchFunctionSubclass():
            out = function(*plain(given), **plain(named))
        if name in ("__setitem__", "tolist", "item", "numpy"):
            return out
        on_gpu = target == GPU if target is not None else bool(there)
        if given and isinstance(given[0], Tensor) and out is not None and _in_place(name):
            return given[0]
        if target == GPU and not there:
            out = _mapped(torch.clone)(out)  # it lies elsewhere
        wrap = _mapped(lambda t: t.as_subclass(OnGPU) if on_gpu else t)
        return wrap(out)

    def _count(
        self,
        name: str,
        given: Sequence[Any],
        named: Mapping[str, Any],
        there: bool,
        target: torch.device | None,
    ) -> None:
        moves = target is not None and name in ("to", "tensor", "as_tensor")
        copied = moves and (target == GPU) != there
        indices = list(_tensors(given[1:2])) if name in ("__getitem__", "__setitem__") else []
        depends = any(t.dtype == torch.bool or not isinstance(t, OnGPU) for t in indices)
        rows = name == "where" and len(given) == 1
        rows |= name == "repeat_interleave" and isinstance(given[-1], Tensor) and not named
        if copied or (there and (name in WAITS or depends or rows)):
            frame = sys._getframe(2)
            where = f"{Path(frame.f_code.co_filename).name}: {frame.f_code.co_name}"
            self.waits[where] += 1


def _in_place(name: str) -> bool:
    if name.startswith("__"):
        return name[3:-2] in ("add", "sub", "mul", "truediv", "and", "or", "xor") and name[2] == "i"
    return name.endswith("_")


def _taken_device(name: str, given: Sequence[Any], named: dict[str, Any]) -> torch.device | None:
    """The device that a call asks for, which is taken out of its named arguments."""
    if name == "cpu":
        return torch.device("cpu")
    device = named.pop("device", None)
    if device is None and name == "to":
        for value in given[1:]:
            if isinstance(value, torch.device | str):
                device = value
            elif isinstance(value, Tensor):
                device = GPU if isinstance(value, OnGPU) else value.device
    return None if device is None else _device(device)


def _device(device: torch.device | str) -> torch.device:
    device = torch.device(device)
    return GPU if device.type == "cuda" else device


def _without_device(given: Sequence[Any], named: dict[str, Any]) -> tuple[Any, ...]:
    """What `to` is asked for besides a device: a type at most."""
    types = [named.pop("dtype", None), *(getattr(v, "dtype", v) for v in given[1:])]
    found = [t for t in types if isinstance(t, torch.dtype)]
    named.clear()
    return given[0], (found or [given[0].dtype])[0]


def _tensors(value: Any) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, dict):
        yield from _tensors(tuple(value.values()))
    elif isinstance(value, tuple | list):
        for each in value:
            yield from _tensors(each)


def _mapped(change: Callable[[Tensor], Any]) -> Callable[[Any], Any]:
    def mapped(value: Any) -> Any:
        if isinstance(value, Tensor):
            return change(value)
        if isinstance(value, dict):
            return {k: mapped(v) for k, v in value.items()}
        if isinstance(value, tuple | list) and type(value) in (tuple, list):
            return type(value)(mapped(v) for v in value)
        if isinstance(value, tuple):  # of names, such as what `max` returns
            return type(value)([mapped(v) for v in value])
        return value

    return mapped


@contextmanager
def pretended_gpu() -> Iterator[PretendedGPU]:
    """While it lasts, `cuda` is a device."""
    with PretendedGPU() as mode:
        yield mode
