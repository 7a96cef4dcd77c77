"""The object on the table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Thing:
    """An object: a cylinder (radius, half height) or a box (half sides), m.

    Attributes:
        kind: cylinder or box.
        mass: In kg.
        friction: The sliding friction coefficient with anything that is not rougher.
    """

    kind: str = "cylinder"
    size: tuple[float, ...] = (0.025, 0.05)
    mass: float = 0.2
    friction: float = 1.0

    @property
    def half_height(self) -> float:
        """The half height of the standing object, m."""
        return self.size[-1]
