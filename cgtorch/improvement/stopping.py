"""When an evolution stops, and its result so far."""

from dataclasses import dataclass, replace

from torch import Tensor

from cgtorch.evolution import Generation, Population
from cgtorch.evolution.population import slim


@dataclass(frozen=True)
class Budget:
    """When to stop an evolution.

    Attributes:
        generations: Maximum number of generations.
        patience: Generations without a better fitness after which it stops, once all is solved.
        stall: Generations without a better fitness after which it gives up.
        enough: The fitness at which it stops at once if all is solved.
        satisfied: The fitness from which it stops after `patience` generations without a better
            one, even if not all is solved; other members solve the rest.
        transitions: Number of executed actions after which no generation begins.
    """

    generations: int = 150
    patience: int = 10
    stall: int = 40
    enough: float = 0.97
    satisfied: float = float("inf")
    transitions: float = float("inf")


@dataclass(frozen=True)
class Found:
    """The result of an evolution so far.

    Attributes:
        champion: The best individual, a population of one without unused slots.
        solved: (B,) bool, what it solves in the environment.
        best: Its fitness, -inf before the first generation.
        since: Generations since the fitness last improved.
        generations: Number of generations so far.
        transitions: Number of actions executed so far.
        seconds: Time so far.
    """

    champion: Population
    solved: Tensor
    best: float
    since: int = 0
    generations: int = 0
    transitions: int = 0
    seconds: float = 0.0

    def after(self, generation: Generation, seconds: float) -> "Found":
        """The result after one more generation, which took `seconds`."""
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
        """Whether the evolution is finished."""
        good = self.best >= budget.enough or self.since >= budget.patience
        settled = self.best >= budget.satisfied and self.since >= budget.patience
        return (
            (bool(self.solved.all()) and good)
            or settled
            or self.since >= budget.stall
            or self.generations >= budget.generations
            or self.transitions >= budget.transitions
        )
