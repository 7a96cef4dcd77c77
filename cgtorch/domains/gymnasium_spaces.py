"""Spaces of Gymnasium as fields: the numbers of observations, and actions from numbers."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cgtorch.ground.errors import DomainError
from cgtorch.ground.fields import Field

LISTED = 12  # names in an error
FAR = 1e30  # beyond which a bound is none
MANY = 200_000  # numbers of a part, beyond which networks and episodes would not fit into memory


@dataclass(frozen=True)
class Part:
    """A part of a space without parts of its own: its name, the keys that lead to it, and itself.

    The parts of a Dict have the names of their keys, those of a Tuple are counted from 1.
    """

    name: str
    keys: tuple[Any, ...]
    space: Any

    def of(self, value: Any) -> Any:
        """The part of a value of the whole space."""
        for key in self.keys:
            value = value[key]
        return value


def parts_of(space: Any, whole: str, name: str = "", keys: tuple[Any, ...] = ()) -> list[Part]:
    """The parts of a space in Gymnasium's order; `whole` is the name of one without parts."""
    from gymnasium.spaces import Dict, Tuple

    if isinstance(space, Dict):
        inner: list[Any] = [
            (f"{name}.{key}" if name else str(key), key, s) for key, s in space.items()
        ]
    elif isinstance(space, Tuple):
        inner = [(f"{name or whole}[{i + 1}]", i, s) for i, s in enumerate(space.spaces)]
    else:
        return [Part(name or whole, keys, space)]
    return [p for label, key, s in inner for p in parts_of(s, whole, label, (*keys, key))]


def _places(shape: tuple[int, ...]) -> list[str]:
    """For each number of an array of this shape, the end of its name, such as " 2" or " 1,3"."""
    each = (",".join(str(i + 1) for i in index) for index in np.ndindex(shape))
    return [f" {place}" if place else "" for place in each]


def _starts(space: Any) -> NDArray[Any]:
    """The smallest values of the choices of a MultiDiscrete."""
    starts: NDArray[Any] = np.broadcast_to(getattr(space, "start", 0), space.nvec.shape)
    return starts


def _size(space: Any) -> int:
    """How many numbers Gymnasium flattens a space to; 0 if it is no numbers."""
    from gymnasium.spaces import flatdim

    try:
        return int(flatdim(space))
    except (NotImplementedError, ValueError):
        return 0


def _unfit(space: Any) -> str:
    """What numbers a space has that gives none, or too many."""
    return f"more than {MANY:,} numbers" if _size(space) > MANY else "no fixed numbers"


def _numbers(part: Part) -> list[str] | None:
    """The names of the numbers of a part, as Gymnasium flattens it; None for none or too many."""
    from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete

    space, name = part.space, part.name
    if _size(space) > MANY:
        return None
    if isinstance(space, Box | MultiBinary):
        return [f"{name}{place}" for place in _places(tuple(space.shape))]
    if isinstance(space, Discrete):
        return [f"{name} = {space.start + i}" for i in range(int(space.n))]
    if isinstance(space, MultiDiscrete):
        each = zip(_places(space.nvec.shape), space.nvec.flat, _starts(space).flat, strict=True)
        return [f"{name}{place} = {first + i}" for place, n, first in each for i in range(n)]
    return None


@dataclass(frozen=True)
class Percepts:
    """How observations become numbers.

    Attributes:
        fields: The D numbers.
        parts: The parts of an observation that have numbers.
        columns: Which of their numbers are taken; all if None.
        left_out: The names of the parts without numbers, and what each has.
    """

    fields: tuple[Field, ...]
    parts: tuple[Part, ...]
    columns: NDArray[Any] | None
    left_out: Mapping[str, str]

    @cached_property
    def _sizes(self) -> tuple[tuple[Part, int | None], ...]:
        """The parts with the lengths of those that stay as they are; others are flattened."""
        from gymnasium.spaces import Box

        def size(space: Any) -> int | None:
            return math.prod(space.shape) if isinstance(space, Box) else None

        return tuple((part, size(part.space)) for part in self.parts)

    def of(self, observation: Any) -> NDArray[Any]:
        """The numbers (D,) of an observation, copied; ValueError for other ones."""
        found = [_read(part, size, observation) for part, size in self._sizes]
        every = np.concatenate(found) if len(found) > 1 else found[0]
        return every if self.columns is None else every[self.columns]


def _read(part: Part, size: int | None, observation: Any) -> NDArray[Any]:
    """The numbers of a part of an observation, copied; a Box with `size` numbers keeps its type."""
    value = part.of(observation)
    if size is None:
        from gymnasium.spaces import flatten

        _check_choices(part, value)
        value = flatten(part.space, value)
    numbers = np.array(value)
    if numbers.dtype.kind not in "biuf":
        raise ValueError(f"{part.name} is of type {numbers.dtype}")
    if size is not None and numbers.size != size:
        raise ValueError(f"{part.name} has {numbers.size} numbers, not {part.space!s:.60}")
    return numbers.ravel()


def _check_choices(part: Part, value: Any) -> None:
    """ValueError for a choice out of its range, which Gymnasium may take for another one."""
    from gymnasium.spaces import Discrete, MultiDiscrete

    space, values, place = part.space, np.ravel(value), 0
    if isinstance(space, Discrete):
        if space.start <= value < space.start + space.n:
            return
        least, most = space.start, space.start + space.n - 1
    elif isinstance(space, MultiDiscrete):
        starts = _starts(space).ravel()
        wrong = (values < starts) | (values >= starts + space.nvec.ravel())
        if not wrong.any():
            return
        place = int(wrong.argmax())
        least, most = starts[place], starts[place] + space.nvec.flat[place] - 1
    else:
        return
    raise ValueError(
        f"{part.name} has {values[place]!s:.40}, and {space!s:.60} has {least} to {most} there: is "
        "its start right?"
    )


def percepts_of(space: Any, patterns: Sequence[str], environment: str) -> Percepts:
    """How observations of a space become percepts: all numbers, or those that match a pattern.

    DomainError if there are none, or a pattern matches none.
    """
    every = parts_of(space, "observation")
    named = [(part, _numbers(part)) for part in every]
    names = [(part.name, name) for part, found in named for name in found or ()]
    left_out = {part.name: _unfit(part.space) for part, found in named if found is None}
    taken = set[int]()
    for pattern in patterns:
        hits = {i for i, both in enumerate(names) if any(_matches(pattern, n) for n in both)}
        if not hits:
            raise DomainError(_no_percepts(pattern, environment, every, left_out))
        taken |= hits
    columns = sorted(taken) if patterns else list(range(len(names)))
    if not columns:
        raise DomainError(
            f"environment {environment!r} has observations {space!s:.200}, and these have "
            f"{' or '.join(dict.fromkeys(left_out.values())) or _unfit(space)}; wrap it "
            "(--wrappers)"
        )
    return Percepts(
        fields=tuple(Field(names[i][1]) for i in columns),
        parts=tuple(part for part, found in named if found),
        columns=np.array(columns) if len(columns) < len(names) else None,
        left_out=left_out,
    )


def _matches(pattern: str, name: str) -> bool:
    return pattern == name or fnmatchcase(name, pattern)


def _no_percepts(
    pattern: str, environment: str, parts: list[Part], left_out: Mapping[str, str]
) -> str:
    """The message about a pattern that matches no number."""
    for part in parts:
        if part.name in left_out and _matches(pattern, part.name):
            return (
                f"percepts {pattern!r:.60}: {part.name} of environment {environment!r} is "
                f"{part.space!s:.80}, which has {left_out[part.name]}; leave it out"
            )
    names = [part.name for part in parts if part.name not in left_out]
    shown = ", ".join(names[:LISTED]) + (", …" if len(names) > LISTED else "")
    return (
        f"percepts {pattern!r:.60} matches nothing that environment {environment!r} shows; it has "
        f"{shown}"
    )


Decoder: TypeAlias = Callable[[NDArray[Any]], Sequence[Any] | NDArray[Any]]
"""Makes n actions from numbers (n, U)."""


@dataclass(frozen=True)
class Controls:
    """How U numbers become actions.

    A number of a Box is itself, within bounds. A discrete choice has a preference for each of its
    values, of which the largest is taken, and a bit is 1 if its preference is above 0.
    """

    fields: tuple[Field, ...]
    actions: Decoder


def controls_of(space: Any, environment: str) -> Controls:
    """How numbers become actions of a space; DomainError for one without fixed numbers."""
    decoders, fields = list[tuple[Part, slice, Decoder]](), list[Field]()
    for part in parts_of(space, "action"):
        own, decoder = _decoded(part, environment)
        decoders.append((part, slice(len(fields), len(fields) + len(own)), decoder))
        fields += own
    if not fields:
        raise DomainError(
            f"environment {environment!r} has actions {space!s:.200}; only numbers and choices "
            "that vary can be controls"
        )
    if decoders[0][0].space is space:  # it has no parts
        return Controls(tuple(fields), decoders[0][2])

    def actions(control: NDArray[Any]) -> list[Any]:
        found = {part.keys: decode(control[:, where]) for part, where, decode in decoders}
        return [_together(space, found, i) for i in range(len(control))]

    return Controls(tuple(fields), actions)


def _together(space: Any, found: dict[Any, Any], row: int, keys: tuple[Any, ...] = ()) -> Any:
    """The action of a Dict or Tuple whose parts have these values, by their keys, in each row."""
    from gymnasium.spaces import Dict, Tuple

    if isinstance(space, Dict):
        return {key: _together(s, found, row, (*keys, key)) for key, s in space.items()}
    if isinstance(space, Tuple):
        return tuple(_together(s, found, row, (*keys, i)) for i, s in enumerate(space.spaces))
    return found[keys][row]


def _decoded(part: Part, environment: str) -> tuple[list[Field], Decoder]:
    """The fields of a part of an action, and how it is made from their numbers."""
    from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete

    space, name = part.space, part.name
    if _size(space) > MANY:
        raise DomainError(
            f"environment {environment!r} has {name} in {space!s:.80}, which is more than {MANY:,} "
            "numbers; wrap it (--wrappers)"
        )
    if isinstance(space, Discrete):
        start = int(space.start)
        names = [f"for {name} {i + 1}" for i in range(int(space.n))]
        return _preferences(names), lambda control: control.argmax(1) + start
    if isinstance(space, Box):
        ends = zip(_places(space.shape), _low(space).flat, _high(space).flat, strict=True)
        fields = [Field(f"{name}{p}", low=float(a), high=float(b)) for p, a, b in ends if a < b]
        return fields, lambda control: _bounded(space, control)
    if isinstance(space, MultiBinary):
        names = [f"for {name}{place}" for place in _places(tuple(space.shape))]
        return _preferences(names), lambda c: (c > 0).astype(space.dtype).reshape(-1, *space.shape)
    if isinstance(space, MultiDiscrete):
        each = zip(_places(space.nvec.shape), space.nvec.flat, strict=True)
        names = [f"for {name}{place}: {i + 1}" for place, n in each for i in range(n)]
        return _preferences(names), lambda control: _chosen(space, control)
    raise DomainError(
        f"environment {environment!r} has {name} in {space!s:.80}; only numbers and choices can be "
        "controls"
    )


def _preferences(names: list[str]) -> list[Field]:
    return [Field(f"preference {name}", low=-1, high=1) for name in names]


def _low(space: Any) -> NDArray[Any]:
    """The lower bounds of a Box; -inf where they are as far away as none."""
    return np.where(space.bounded_below & (space.low > -FAR), space.low, -np.inf)


def _high(space: Any) -> NDArray[Any]:
    """The upper bounds of a Box; inf where they are as far away as none."""
    return np.where(space.bounded_above & (space.high < FAR), space.high, np.inf)


def tried(space: Any) -> Any:
    """The space of actions of random episodes: of Boxes without bounds that are as far as none.

    Gymnasium draws numbers without bounds near 1, and others uniformly within them.
    """
    from gymnasium.spaces import Box, Dict, Tuple

    if isinstance(space, Dict):
        return Dict({key: tried(s) for key, s in space.items()})
    if isinstance(space, Tuple):
        return Tuple([tried(s) for s in space.spaces])
    floats = isinstance(space, Box) and np.issubdtype(space.dtype, np.floating)
    return Box(_low(space), _high(space), dtype=space.dtype) if floats else space


def _bounded(space: Any, control: NDArray[Any]) -> NDArray[Any]:
    """Values of a Box from its numbers (n, U), of which it lacks those that cannot vary."""
    low = space.low.ravel().astype(np.float64)
    values = np.tile(low, (len(control), 1))
    values[:, low < space.high.ravel()] = control
    shaped = values.reshape(-1, *space.shape)
    within: NDArray[Any] = shaped.clip(space.low, space.high).astype(space.dtype)
    return within


def _chosen(space: Any, control: NDArray[Any]) -> NDArray[Any]:
    """Values of a MultiDiscrete from preferences (n, U)."""
    ends = np.cumsum(space.nvec.ravel())
    best = [part.argmax(1) for part in np.split(control, ends[:-1], axis=1)]
    values = np.stack(best, 1).reshape(-1, *space.nvec.shape) + _starts(space)
    chosen: NDArray[Any] = values.astype(space.dtype)
    return chosen
