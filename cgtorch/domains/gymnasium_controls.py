"""Actions of Gymnasium environments from the numbers of controls."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cgtorch.domains.gymnasium_spaces import (
    FAR,
    MANY,
    Part,
    numbers_of,
    parts_of,
    size_of,
    starts_of,
)
from cgtorch.ground.errors import DomainError
from cgtorch.ground.fields import Field

OFF = 4.0  # times half the range: how far from 0 its middle is, at most, for a number as it is
TINY, HUGE = 0.01, 100.0  # half the range, at least and at most, for a number as it is
EXACT = 2.0**53  # beyond which bounds are hardly meant, and floats are no longer all integers

Decoder: TypeAlias = Callable[[NDArray[Any]], Sequence[Any] | NDArray[Any]]
"""Makes n actions from numbers (n, U)."""


@dataclass(frozen=True)
class Controls:
    """How U numbers become actions.

    A number of a Box is itself, within bounds. If these are far from 0 for their range, or the
    range is tiny or huge, it is a share of the range, and its field says so: -1 is the lower bound
    and 1 the upper one. A discrete choice has a preference for each of its values, of which the
    largest is taken, and a bit is 1 if its preference is above 0.
    """

    fields: tuple[Field, ...]
    actions: Decoder


def controls_of(space: Any, environment: str) -> Controls:
    """How numbers become actions of a space; DomainError for one without fixed numbers."""
    decoders, fields = list[tuple[Part, slice, Decoder]](), list[Field]()
    parts = parts_of(space, "action")
    for part in parts:
        own, decoder = _decoded(part, environment)
        decoders.append((part, slice(len(fields), len(fields) + len(own)), decoder))
        fields += own
    if not fields or not any(_varies(part.space) for part in parts):
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


def _varies(space: Any) -> bool:
    """Whether there is anything to choose in a space without parts."""
    from gymnasium.spaces import Box, Discrete, MultiDiscrete

    if isinstance(space, Discrete):
        return bool(space.n > 1)
    if isinstance(space, MultiDiscrete):
        return bool((space.nvec > 1).any())
    return not isinstance(space, Box) or bool((space.low < space.high).any())


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
    if size_of(space) > MANY:
        raise DomainError(
            f"environment {environment!r} has {name} in {space!s:.80}, which is more than {MANY:,} "
            "numbers; wrap it (--wrappers)"
        )
    if isinstance(space, Box):
        return _box(part)
    preferences = [
        Field(f"preference for {number}", low=-1, high=1) for number in numbers_of(part) or ()
    ]
    if isinstance(space, Discrete):
        start = int(space.start)
        return preferences, lambda control: control.argmax(1) + start
    if isinstance(space, MultiBinary):
        return preferences, lambda c: (c > 0).astype(space.dtype).reshape(-1, *space.shape)
    if isinstance(space, MultiDiscrete):
        return preferences, lambda control: _chosen(space, control)
    raise DomainError(
        f"environment {environment!r} has {name} in {space!s:.80}; only numbers and choices can be "
        "controls"
    )


def _box(part: Part) -> tuple[list[Field], Decoder]:
    """The fields of a Box that can vary, and its values from their numbers (n, U)."""
    space = part.space
    varies = (space.low < space.high).ravel()
    low, high = (end.ravel()[varies] for end in (_low(space), _high(space)))
    shares, names = _shared(low, high), np.array(numbers_of(part))[varies].tolist()
    ends = zip(*(each.ravel()[varies] for each in (space.low, space.high)), strict=True)
    fields = [
        Field(f"{name} from {_short(a)} (-1) to {_short(b)} (1)", low=-1, high=1)
        if share
        else Field(name, low=float(least), high=float(most))
        for name, share, least, most, (a, b) in zip(names, shares, low, high, ends, strict=True)
    ]
    whole = np.issubdtype(space.dtype, np.integer)
    constant = space.low.ravel().astype(np.float64)

    def actions(control: NDArray[Any]) -> NDArray[Any]:
        values = np.tile(constant, (len(control), 1))
        values[:, varies] = control
        if shares.any():
            share = (control[:, shares].astype(np.float64).clip(-1, 1) + 1) / 2
            within = (1 - share) * low[shares] + share * high[shares]
            values[:, np.flatnonzero(varies)[shares]] = np.rint(within) if whole else within
        shaped = values.reshape(-1, *space.shape)
        found: NDArray[Any] = shaped.clip(space.low, space.high).astype(space.dtype)
        return found

    return fields, actions


def _shared(low: NDArray[Any], high: NDArray[Any]) -> NDArray[Any]:
    """Which numbers within bounds (U,) are shares of their range, as numbers near 1 say little."""
    known = np.maximum(abs(low), abs(high)) < EXACT
    least, most = (np.where(known, end, 0.0) for end in (low, high))
    middle, half = (least + most) / 2, (most - least) / 2
    odd: NDArray[Any] = (abs(middle) > OFF * half) | (half < TINY) | (half > HUGE)
    return known & odd


def _short(bound: Any) -> str:
    """A bound with as many digits as its type tells apart."""
    return str(bound).removesuffix(".0")


def _low(space: Any) -> NDArray[Any]:
    """The lower bounds of a Box as floats; -inf where they are as far away as none."""
    low = space.low.astype(np.float64)
    return np.where(space.bounded_below & (low > -FAR), low, -np.inf)


def _high(space: Any) -> NDArray[Any]:
    """The upper bounds of a Box as floats; inf where they are as far away as none."""
    high = space.high.astype(np.float64)
    return np.where(space.bounded_above & (high < FAR), high, np.inf)


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
    if not floats:
        return space
    low, high = (end.astype(space.dtype) for end in (_low(space), _high(space)))
    return Box(low, high, dtype=space.dtype)


def _chosen(space: Any, control: NDArray[Any]) -> NDArray[Any]:
    """Values of a MultiDiscrete from preferences (n, U)."""
    ends = np.cumsum(space.nvec.ravel())
    best = [part.argmax(1) for part in np.split(control, ends[:-1], axis=1)]
    values = np.stack(best, 1).reshape(-1, *space.nvec.shape) + starts_of(space)
    chosen: NDArray[Any] = values.astype(space.dtype)
    return chosen
