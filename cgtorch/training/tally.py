"""What a stage or round has cost, and what it has found, counted from its events."""

from dataclasses import dataclass
from math import inf
from typing import Any

from cgtorch.evolution import Generation, Population
from cgtorch.graphs import Skill
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    Practised,
    SkillAccepted,
)
from cgtorch.improvement.setup import Progress


@dataclass
class Tally:
    """The cost of a stage, the last skill it accepted, and the fittest individual."""

    generations: int = 0
    transitions: int = 0
    searching: float = 0.0  # s
    seconds: float = 0.0  # of all of it
    accepted: SkillAccepted[Any] | None = None
    champion: Population | None = None
    best: tuple[int, float] = (-1, -inf)  # what it solves, and its fitness
    skill: Skill | None = None  # the last one that was tried
    in_a_row: int = 0  # fresh scenarios that the last skill solved
    episodes: int = 0  # that a search for the best mean has played

    def count(self, event: Event) -> None:
        """Update by an event."""
        if isinstance(event, GenerationDone):
            solved = event.solved_w + event.solved_m
            self._add(1, event.generation, solved, event.seconds)
        elif isinstance(event, EvolutionRecalled):
            found = event.found
            self._add(found.generations, found, int(found.solved.sum()), found.seconds)
        elif isinstance(event, SkillAccepted):
            self.accepted = event
        elif isinstance(event, Practised):
            self.in_a_row, self.skill = event.in_a_row, event.skill
        elif isinstance(event, MeanTested):
            self.episodes, self.skill = event.episodes, event.skill

    def _add(
        self, generations: int, found: Generation | Found, solved: int, seconds: float
    ) -> None:
        self.generations += generations
        self.transitions += found.transitions
        self.searching += seconds
        # Evolutions on more scenarios come later, so those that are solved come first.
        if (solved, found.best) > self.best:
            self.champion, self.best = found.champion, (solved, found.best)

    def result(
        self,
        before: Progress[Any],
        skill: Skill,
        seconds: float,
        asked: dict[str, dict[str, int]],
    ) -> dict[str, Any]:
        """The common part of the results of stages and rounds, given the progress before.

        `asked` are the world actions of the run so far, by phase.
        """
        accepted = self.accepted
        lost = 0 if accepted is None else int((~accepted.succeeded[accepted.keep]).sum())
        return {
            "skill": skill.name,
            "w_size": len(before.solved),
            "w_lost": lost,
            "nodes": skill.num_nodes,
            "depth": skill.depth,
            "generations": self.generations,
            "transitions": self.transitions,
            "seconds": round(seconds, 1),
            "search_seconds": round(self.searching, 3),
            "asked": asked,
        }
