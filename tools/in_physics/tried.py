"""A row of what was tried in physics."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class Tried:
    """So many grasps or placements: those that lifted, and those that did without a touch."""

    about: str
    tried: int
    lifted: int
    strict: int
    asked: str


Rows: TypeAlias = Iterator[tuple[str, Callable[[], Tried]]]
"""What each row is about, and what measures it."""


@dataclass(frozen=True)
class Sizes:
    """How much is tried: poses or placements on the perimeter, and the seeds of skills."""

    count: int
    seeds: range

    @property
    def fewer(self) -> int:
        """Of what is tried with several objects, or along each edge."""
        return max(1, self.count * 3 // 10)
