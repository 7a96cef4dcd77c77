"""`cgtorch-train` on one task, with its default settings, which ends at the budget."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from measure_robot_tasks import player_of

from cgtorch.graphs import Skill
from cgtorch.ground.asked import Asked
from cgtorch.improvement.events import Event, GenerationDone, Practised
from cgtorch.training.run import train
from cgtorch.training.train import NotImprovedError
from robot_tasks.problem import Found, Problem

GIVEN = "nothing more: graphs of any primitives and of networks that choose, and the grade"


@dataclass
class Meter:
    """A watch that notes what was asked up to each practice, and ends a run at the budget.

    `best` is the skill that has solved most fresh starts in a row, or the best individual of the
    first search, as long as no skill has practised.
    """

    problem: Problem
    best: Skill | None = None
    in_a_row: int = -1
    met: bool = False
    asked: Asked = field(default_factory=Asked)

    def __call__(self, event: Event) -> bool:
        """Take note of an event; whether the run is to stop."""
        if not isinstance(event, GenerationDone | Practised) or self.met:
            return False  # what is tried after the criterion was met is of no interest
        self.asked = self.problem.asked
        if isinstance(event, Practised):
            if event.in_a_row >= self.in_a_row:
                self.best, self.in_a_row = event.skill, event.in_a_row
            self.met = event.in_a_row >= event.wanted
        elif self.in_a_row < 0:
            self.best = self.problem.skill(event.generation.champion.graphs)
        return self.problem.over and not self.met


def search(problem: Problem, **settings: Any) -> Found:
    """Train until the stage ends, or a generation or a practice has spent the budget."""
    meter, folder = Meter(problem), Path(mkdtemp())
    how = {"seed": problem.seed, "practice": problem.practice, "quiet": True, **settings}
    try:
        train(problem.domain, folder / "run", watch=meter, **how)
    except NotImprovedError:  # it has made all attempts without a skill
        pass
    finally:
        shutil.rmtree(folder)
    play = None if meter.best is None else player_of(meter.best)
    return Found(play, meter.met, meter.asked)
