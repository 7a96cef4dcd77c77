"""Why a skill fails, as data: kinds of failure with their causes, and what follows from them."""

from dataclasses import dataclass
from math import inf
from typing import Any

from torch import Tensor

from cgtorch.domains.way import Way
from cgtorch.graphs import Skill

CAUSES = {
    "unreachable": "nothing solves them, says the domain",
    "noise": "the skill solves them under most other noise",
    "limit": "the skill solves them if it may take more transitions",
    "classifier": "they are solved in Γ and C, and C says success where a test in the world fails",
    "gamma": "they are solved in Γ and C, and the world leads elsewhere",
    "search": "they fail in Γ and C, too",
    "world": "the skill was evolved in the world itself, and no better one was found",
    "open": "the models in which the skill was evolved are not at hand",
}
"""What can cause a failure, and how it is known. Each failure has the first of these that holds."""


@dataclass(frozen=True)
class Cause:
    """A cause, a key of `CAUSES`, and the numbers of the scenarios that fail because of it."""

    name: str
    scenarios: tuple[int, ...]


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Failure:
    """A kind of failure.

    Attributes:
        end: failure or timeout.
        node: Where the skill ended, as in `Act`, with the outcome.
        scenarios: The numbers of the scenarios that failed in this way. The first is the example.
        causes: Why, of those that were looked into, the most frequent cause first.
        returns: The returns of the scenarios; () without rewards.
        way: What the skill did in the example.
    """

    end: str
    node: str
    scenarios: tuple[int, ...]
    causes: tuple[Cause, ...]
    returns: tuple[float, ...]
    way: Way


@dataclass(frozen=True)
class Split:
    """How first percepts tell failures from successes: one number, on one side of a threshold.

    Attributes:
        name: The name of the number.
        unit: Its unit.
        threshold: Failures are beyond it.
        above: Whether they are above it, else below.
        failed: How many failures are on that side, of how many in all.
        solved: How many successes are on that side, of how many in all.
    """

    name: str
    unit: str
    threshold: float
    above: bool
    failed: tuple[int, int]
    solved: tuple[int, int]


@dataclass(frozen=True)
class Searched:
    """What the log of a run says of the search for its last skill.

    Attributes:
        stage: The stage or round.
        generations: The number of generations.
        limit: The largest number of generations of one evolution.
        solving: The largest share of a generation that solved anything.
        rising: Whether the last evolution reached its limit while its fitness still rose.
        ended: Why it ended: "goal", "practice", "failed" (no skill was found), "limits" (of time,
            rounds or budget), or "interrupted".
        value: The goal, or the number of scenarios solved in a row; 0 otherwise.
        imagined: The most scenarios that an individual solved where it was evolved, of how many.
        met: How many episodes in the world succeeded, of how many.
        limits: The limits of the training, such as "--minutes 2".
        best: The largest fitness of an individual, -inf if none had any.
        scarce: Settings that are far below the usual ones, such as "--attempts 1 (usually 24)".
    """

    stage: str
    generations: int
    limit: int
    solving: float
    rising: bool
    ended: str
    value: float = 0.0
    imagined: tuple[int, int] = (0, 0)
    met: tuple[int, int] = (0, 0)
    limits: str = ""
    best: float = -inf
    scarce: tuple[str, ...] = ()


@dataclass(frozen=True)
class Advice:
    """A sentence about what to change, because of a cause of so many failures."""

    cause: str
    count: int
    text: str


@dataclass(frozen=True)
class Tried:
    """How many scenarios of a kind were tried, and how many of them were solved.

    `made` is whether a skill for the kind has been found.
    """

    kind: str
    tried: int
    succeeded: int
    made: bool = True


@dataclass(frozen=True, eq=False)
class Failures:
    """Why a skill fails.

    Attributes:
        skill: Its name; "" if the run has none yet.
        tried: What was tried, by the kind of scenarios.
        looked: The number of failures that were looked at.
        lucky: How many of them succeeded when they were met again.
        kinds: The kinds of failure, the most frequent first.
        split: How failures begin otherwise than successes; None if no number tells them apart.
        blame: A sentence on whether the models or the search are to blame; "" without failures.
        advice: What to change, the advice about the most failures first.
    """

    skill: str
    tried: tuple[Tried, ...] = ()
    looked: int = 0
    lucky: int = 0
    kinds: tuple[Failure, ...] = ()
    split: Split | None = None
    blame: str = ""
    advice: tuple[Advice, ...] = ()

    def label(self, scenario: int) -> str:
        """The name of a scenario: its number among those of its kind, from 0, after the kind."""
        for each in self.tried:
            if scenario < each.tried:
                return f"{each.kind} {scenario}".strip()
            scenario -= each.tried
        return str(scenario)

    @property
    def failed(self) -> int:
        """The number of scenarios that failed."""
        return sum(each.tried - each.succeeded for each in self.tried)

    def causes(self) -> dict[str, int]:
        """How many failures have each cause, the most frequent first."""
        found = dict.fromkeys(CAUSES, 0)
        for kind in self.kinds:
            for cause in kind.causes:
                found[cause.name] += len(cause.scenarios)
        return {name: found[name] for name in sorted(found, key=lambda n: -found[n]) if found[name]}


@dataclass(frozen=True, eq=False)
class Explained:
    """Why the last skill of a run fails, with the B scenarios whose numbers `found` has.

    `succeeded` (B,) bool says which of them it solves. Fresh ones are drawn from `seed`. Without a
    skill there are none.
    """

    found: Failures
    seed: int = 0
    skill: Skill | None = None
    scenarios: Any = None
    succeeded: Tensor | None = None
