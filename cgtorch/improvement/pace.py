"""How a search divides what it plays, by what a lane costs.

Where each lane is an environment of its own, or where steps are what is compared, every step costs.
Where lanes are rows of tensors, a rollout of hundreds takes hardly longer than one. So rivals are
tuned in the same rollouts, on more scenarios, and none is given up early.
"""

from dataclasses import dataclass

from cgtorch.ground.environment import Bounded, Environment, Frugal


@dataclass(frozen=True)
class Pace:
    """How a search divides what it plays.

    Attributes:
        at_once: Number of scenarios that take hardly longer than a single one.
        together: Whether rivals are tuned in the same rollouts.
        ahead: What wins races is tuned so many times as much as its rivals.
        rungs: Updates after which the worse half of the rivals ends.
        racing: The search executes so many times as many actions as races and their winners' tests.
        known: Number of episodes by which the mean of a new holder is known.
    """

    at_once: int
    together: bool
    ahead: int
    rungs: tuple[int, int]
    racing: int
    known: int


BY_STEP = Pace(1, False, 5, (5, 15), 8, 4)
BY_ROLLOUT = Pace(8, True, 1, (60, 180), 4, 16)


def pace_of(environment: Environment) -> Pace:
    """The pace of a search in an environment."""
    frugal = isinstance(environment, Frugal) and environment.frugal
    return BY_STEP if frugal or isinstance(environment, Bounded) else BY_ROLLOUT
