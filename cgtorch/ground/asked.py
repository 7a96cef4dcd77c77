"""World actions: what a run asks of its world, which on a robot takes time and wear."""

import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, fields
from math import inf

from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import CgtorchError

LATE = "the time is over; give more (minutes, --minutes)"


class BudgetSpentError(CgtorchError, RuntimeError):
    """The next world action would exceed the budget of the run; it was not asked."""


@dataclass(frozen=True)
class Asked:
    """Numbers of things that were asked of a world.

    Motions and tests of success are world actions. Looks are first percepts without an action, and
    each needs a placed scene. Episodes are trials of a skill. Where a motion consists of several
    low-level steps, these are counted, too: those that a robot would make, and those that were
    simulated, as equal ones are simulated once.
    """

    motions: int = 0
    tests: int = 0
    looks: int = 0
    episodes: int = 0
    steps: int = 0
    simulated: int = 0

    def __add__(self, other: "Asked") -> "Asked":
        return Asked(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __sub__(self, other: "Asked") -> "Asked":
        return Asked(*(a - b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def actions(self) -> int:
        """The number of world actions."""
        return self.motions + self.tests


NOTHING = Asked()
NAMES = tuple(f.name for f in fields(Asked))


@dataclass
class Purse:
    """Counts what is asked, by phase, and refuses what the budget does not cover.

    Attributes:
        limits: The largest numbers by name; names without a limit are absent.
        spent: World actions so far, by phase.
        exhausted: Whether something was refused.
        until: When no further action may begin, on the clock of `time.monotonic`.
        settled: Whether a search has its result, so that nothing is left to break off.
        telling: Whether something is being told, which is not broken off.
        unreturned: What had not returned for long when a step was broken off, such as "step 7 of
            environment 'own:Cart-v0' has not returned for 61 s"; "" if nothing.
    """

    limits: Mapping[str, float] = field(default_factory=dict)
    spent: dict[str, Asked] = field(default_factory=dict)
    exhausted: bool = False
    until: float = inf
    settled: bool = False
    telling: bool = False
    unreturned: str = ""

    def late(self, grace: float = 0.0) -> bool:
        """Whether the time has been over for so many seconds, by the clock of the first rank."""
        return self.until < inf and ranks.broadcast(time.monotonic() >= self.until + grace)

    @property
    def total(self) -> Asked:
        """World actions of all phases."""
        return sum(self.spent.values(), Asked())

    def pay(self, phase: str, asked: Asked) -> None:
        """Count what is asked next; BudgetSpentError, and nothing is counted, beyond a limit."""
        if self.late():
            self.exhausted = True
            raise BudgetSpentError(LATE)
        after = self.total + asked
        for name, limit in self.limits.items():
            if getattr(asked, name) and getattr(after, name) > limit:
                self.exhausted = True
                raise BudgetSpentError(
                    f"the budget of {limit:g} {name} is spent; raise it (budget, --budget)"
                )
        self.add(phase, asked)

    def add(self, phase: str, asked: Asked) -> None:
        """Count what was asked before, such as before an interruption."""
        self.spent[phase] = self.spent.get(phase, NOTHING) + asked
