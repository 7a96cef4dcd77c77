"""Journals: how a stage that was interrupted goes on as if nothing had happened.

Everything here depends on seeds alone, so a stage that is made again does the same again. A journal
holds what its long steps came to, in their order, each with the state of the random numbers after
it. Made again, the stage reads them instead of computing them, and goes on computing where the
journal ends. Of an evolution there is, too, where it stood a while ago.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor


@dataclass(frozen=True)
class Standing:
    """Where a step stands.

    Attributes:
        about: what it has come to so far.
        parts: each gives a part of what it goes on from, which may be large, when it is called.
            All ranks call those that they call in the same order; what is kept is what the first
            one gets.
        apart: whether parts are held by several ranks, so that no rank has all without the others.
    """

    about: dict[str, Tensor]
    parts: tuple[Callable[[], dict[str, Tensor]], ...]
    apart: bool = False


class Journal(Protocol):
    """What a stage has done so far, told in the order in which it was done."""

    def recall(self, step: str) -> dict[str, Tensor] | None:
        """What the next step came to; None if it has not ended yet.

        Args:
            step: what the step is; the stage asks for its steps in the order it took them.

        Raises:
            RunError: the journal says that another step came next.
        """
        ...

    def record(self, step: str, result: dict[str, Tensor]) -> None:
        """Keep what a step that was not recalled has come to."""
        ...

    def recall_standing(self, step: str) -> Standing | None:
        """Where the next step stood when it was interrupted; None if that was not kept."""
        ...

    def record_standing(self, step: str, standing: Standing) -> None:
        """Keep where a step stands, unless that was kept a moment ago; all ranks call it."""
        ...


class NoJournal:
    """Recalls nothing and keeps nothing."""

    def recall(self, step: str) -> dict[str, Tensor] | None:
        """None."""
        return None

    def record(self, step: str, result: dict[str, Tensor]) -> None:
        """Do nothing."""

    def recall_standing(self, step: str) -> Standing | None:
        """None."""
        return None

    def record_standing(self, step: str, standing: Standing) -> None:
        """Do nothing."""
