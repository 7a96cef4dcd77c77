"""What can be chosen to be shown: skills, scenarios, and where the object lies."""

from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.world import ObservedTabletop, Scenarios, draw_of
from cgtorch.tabletop.world.geometry import rotate
from cgtorch.training.evaluate import check_percepts

FROM_EDGE = 0.03  # m that a dragged object keeps from the table's edges


@dataclass(frozen=True)
class Candidate:
    """A skill that can be shown, and the tabletop that it is for."""

    skill: Skill
    domain: Tabletop

    def world(self, scenarios: Scenarios) -> ObservedTabletop:
        """The world that it acts in; SettingsError if the skill is for other percepts."""
        world = self.domain.world(scenarios)
        check_percepts(self.skill, world.percept_size, "such scenarios")
        return world


@dataclass(frozen=True)
class Wish:
    """What is to be shown first: names of candidates, one of them to compare with or none.

    Of so many scenarios of a kind one can be chosen; `seed` is that of them and their noise.
    """

    skill: str
    against: str | None
    scenarios: str
    count: int
    seed: int


def scenario_of(kind: str, count: int, seed: int, number: int) -> Scenarios:
    """The scenario of a number, from 0 on, of those that `cgtorch-evaluate` tries."""
    drawn = draw_of(kind)(count, Generator().manual_seed(seed))
    return drawn[torch.tensor([number])]


def put_object(scenario: Scenarios, at: Tensor) -> Scenarios:
    """The scenario with its object at (2,) m, or at the nearest place on the table."""
    table = scenario.table[0]
    half = table[3:5] / 2 - FROM_EDGE
    local = rotate(at - table[:2], -table[2])
    placed = rotate(local.clamp(-half, half), table[2]) + table[:2]
    return replace(scenario, object=placed[None])
