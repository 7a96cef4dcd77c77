"""An action as plain data, its class and arguments, and the library's actions from such data."""

import inspect
import math
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from cgtorch.graphs.action import Action
from cgtorch.ground.errors import ActionError

LIBRARY = "cgtorch."
"""The modules from which the class of an action in a file is imported."""
LARGEST = 2**20  # parameters, or numbers of a message or memory


def described_action(action: Action) -> dict[str, Any]:
    """The class of an action, and the arguments that it has as attributes."""
    kind = type(action)
    names = inspect.signature(kind).parameters
    found = {name: getattr(action, name) for name in names if hasattr(action, name)}
    plain = {name: value for name, value in found.items() if _is_plain(value)}
    return {"class": f"{kind.__module__}:{kind.__qualname__}", "arguments": plain}


def _is_plain(value: object) -> bool:
    """Whether a value is a finite number, a text, or a tuple of such, as JSON can hold them."""
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, bool | int | str)


def made_action(name: str, spec: str, arguments: Mapping[str, Any]) -> Action:
    """One of the library's actions; ActionError if it is not one, or cannot be made like that."""
    module, _, kind = spec.partition(":")
    if not module.startswith(LIBRARY):
        raise ActionError(
            f"action {name!r:.80} is {spec!r:.80}, which is code of its own; give the actions of "
            "the skill"
        )
    try:
        found = getattr(import_module(module), kind)
    except (ImportError, AttributeError, ValueError) as e:
        raise ActionError(f"action {name!r:.80} is {spec!r:.80}, which is not there") from e
    if not (isinstance(found, type) and issubclass(found, Action)):
        raise ActionError(f"action {name!r:.80} is {spec!r:.80}, which is no action")
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in arguments.items()}
    try:
        made = found(**values)
    except Exception as e:  # whatever arguments of a file may cause
        raise ActionError(f"action {name!r:.80} cannot be made with {values!r:.80}") from e
    sizes = made.num_parameters, made.message_size, made.memory_size
    if not all(type(size) is int and 0 <= size <= LARGEST for size in sizes):
        raise ActionError(f"action {name!r:.80} cannot be made with {values!r:.80}")
    return made
