"""The object on the table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Thing:
    """An object: a cylinder (radius, half height) or a box (half sides), m.

    Attributes:
        kind: cylinder or box.
        mass: in kg.
        friction: the coefficient of sliding between it and anything that is as rough at most.
    """

    kind: str = "cylinder"
    size: tuple[float, ...] = (0.025, 0.05)
    mass: float = 0.2
    friction: float = 1.0

    @property
    def half_height(self) -> float:
        """Of the standing object, m."""
        return self.size[-1]
