"""Spaces of Gymnasium, their parts, and the numbers of observations as fields."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

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


def starts_of(space: Any) -> NDArray[Any]:
    """The smallest values of the choices of a MultiDiscrete."""
    starts: NDArray[Any] = np.broadcast_to(getattr(space, "start", 0), space.nvec.shape)
    return starts


def size_of(space: Any) -> int:
    """How many numbers Gymnasium flattens a space to; 0 if it is no numbers."""
    from gymnasium.spaces import flatdim

    try:
        return int(flatdim(space))
    except (NotImplementedError, ValueError):
        return 0


def _unfit(space: Any) -> str:
    """What numbers a space has that gives none, or too many."""
    return f"more than {MANY:,} numbers" if size_of(space) > MANY else "no fixed numbers"


def numbers_of(part: Part) -> list[str] | None:
    """The names of the numbers of a part, as Gymnasium flattens it; None for none or too many."""
    from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete

    space, name = part.space, part.name
    if size_of(space) > MANY:
        return None
    if isinstance(space, Box | MultiBinary):
        return [f"{name}{place}" for place in _places(tuple(space.shape))]
    if isinstance(space, Discrete):
        return [f"{name} = {space.start + i}" for i in range(int(space.n))]
    if isinstance(space, MultiDiscrete):
        each = zip(_places(space.nvec.shape), space.nvec.flat, starts_of(space).flat, strict=True)
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
        starts = starts_of(space).ravel()
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
    named = [(part, numbers_of(part)) for part in every]
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
