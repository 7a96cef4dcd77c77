"""What an evolution has come to, and when it ends."""

from dataclasses import dataclass, replace

from torch import Tensor

from cgtorch.evolution import Generation, Population
from cgtorch.evolution.population import slim


@dataclass(frozen=True)
class Budget:
    """When to stop searching.

    Attributes:
        generations: the most for one evolution.
        patience: generations without a better fitness, once all is solved in the models.
        stall: generations without a better fitness after which the search gives up.
        enough: fitness with which a candidate that solves all is good enough.
        satisfied: fitness from which on the scenarios that it does not solve are left to others,
            after `patience` generations without a better one.
        transitions: actions executed in the models after which no generation is begun.
    """

    generations: int = 150
    patience: int = 10
    stall: int = 40
    enough: float = 0.97
    satisfied: float = float("inf")
    transitions: float = float("inf")


@dataclass(frozen=True)
class Found:
    """What an evolution has come to so far.

    Attributes:
        champion: the best individual, as a population of one without unused slots.
        solved: (B,) bool what it solves in the models.
        best: its fitness, -inf before the first generation.
        since: generations without a better one.
        generations: how many there were.
        transitions: actions executed in the models.
        seconds: what they took.
    """

    champion: Population
    solved: Tensor
    best: float
    since: int = 0
    generations: int = 0
    transitions: int = 0
    seconds: float = 0.0

    def after(self, generation: Generation, seconds: float) -> "Found":
        """With one more generation, which took so many seconds."""
        counted = replace(
            self,
            since=self.since + 1,
            generations=self.generations + 1,
            transitions=self.transitions + generation.transitions,
            seconds=self.seconds + seconds,
        )
        fitness = generation.best
        if fitness <= self.best + 1e-3:
            return counted
        champion, solved = slim(generation.champion), generation.succeeded  # on any rank the same
        return replace(counted, champion=champion, solved=solved, best=fitness, since=0)

    def ends(self, budget: Budget) -> bool:
        """Whether the evolution is over."""
        good = self.best >= budget.enough or self.since >= budget.patience
        settled = self.best >= budget.satisfied and self.since >= budget.patience
        return (
            (bool(self.solved.all()) and good)
            or settled
            or self.since >= budget.stall
            or self.generations >= budget.generations
            or self.transitions >= budget.transitions
        )
