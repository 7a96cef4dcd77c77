"""Names, units and bounds of the numbers of a percept or a control."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.ground.errors import DomainError

KINDS = ("number", "angle", "discrete")


@dataclass(frozen=True)
class Field:
    """One number of a percept or a control; DomainError for an unknown kind or impossible bounds.

    Attributes:
        name: Its name in pictures, reports and exported code.
        unit: Such as "m"; an angle is in rad.
        low: The smallest possible value; of a control, the smallest that is worth trying.
        high: The largest.
        kind: "number"; "angle", the same after a whole turn; or "discrete", a whole number.
    """

    name: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    kind: str = "number"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise DomainError(
                f"field {self.name!r} is of kind {self.kind!r}; use one of {', '.join(KINDS)}"
            )
        if not self.low < self.high:
            raise DomainError(
                f"field {self.name!r} lies between {self.low} and {self.high}; give a range"
            )


def named(
    *names: str, unit: str = "", low: float = -math.inf, high: float = math.inf
) -> tuple[Field, ...]:
    """Fields that differ only in their names."""
    return tuple(Field(name, unit, low, high) for name in names)


def columns_of(fields: Sequence[Field], kind: str) -> list[int]:
    """Indices of the fields of a kind."""
    return [i for i, field in enumerate(fields) if field.kind == kind]


def bounds_of(fields: Sequence[Field]) -> tuple[Tensor, Tensor]:
    """The lower bounds (D,) and upper bounds (D,) of the fields."""
    return torch.tensor([f.low for f in fields]), torch.tensor([f.high for f in fields])


def wrapped(angle: Tensor) -> Tensor:
    """Angles in rad, wrapped to [-π, π)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def within_bounds(values: Tensor, fields: Sequence[Field]) -> Tensor:
    """Values (..., D) clamped to the bounds of their fields; angles are wrapped if possible."""
    low, high = (bound.to(values) for bound in bounds_of(fields))
    angles = columns_of(fields, "angle")
    if not angles:
        return values.clamp(low, high)
    columns = list(values.unbind(-1))
    for i in angles:
        middle = ((low[i] + high[i]) / 2).nan_to_num(0, 0, 0)
        columns[i] = wrapped(columns[i] - middle) + middle
    return torch.stack(columns, -1).clamp(low, high)


def as_features(values: Tensor, fields: Sequence[Field]) -> Tensor:
    """Values (..., D) in which the sine and cosine of each angle replace it, at the end."""
    angles = columns_of(fields, "angle")
    if not angles:
        return values
    others = [i for i in range(len(fields)) if i not in angles]
    turned = values[..., angles]
    return torch.cat([values[..., others], turned.sin(), turned.cos()], -1)
