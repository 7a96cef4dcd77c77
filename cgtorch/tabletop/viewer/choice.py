"""The choices on the page: skills, scenarios, and where the object is."""

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
    """A skill that can be shown, and its tabletop."""

    skill: Skill
    domain: Tabletop

    def world(self, scenarios: Scenarios) -> ObservedTabletop:
        """The world of scenarios; SettingsError if the skill reads other percepts."""
        world = self.domain.world(scenarios)
        check_percepts(self.skill, world.percept_size, "such scenarios")
        return world


@dataclass(frozen=True)
class Wish:
    """The first choice: names of candidates, one of them to compare with or none.

    There are `count` scenarios of a kind to choose from; `seed` is that of these and their noise.
    """

    skill: str
    against: str | None
    scenarios: str
    count: int
    seed: int


def scenario_of(kind: str, count: int, seed: int, number: int) -> Scenarios:
    """Scenario `number`, from 0 on, of those that `cgtorch-evaluate` tries."""
    drawn = draw_of(kind)(count, Generator().manual_seed(seed))
    return drawn[torch.tensor([number])]


def put_object(scenario: Scenarios, at: Tensor) -> Scenarios:
    """The scenario with its object at (2,) m, or at the nearest place on the table."""
    table = scenario.table[0]
    half = table[3:5] / 2 - FROM_EDGE
    local = rotate(at - table[:2], -table[2])
    placed = rotate(local.clamp(-half, half), table[2]) + table[:2]
    return replace(scenario, object=placed[None])
