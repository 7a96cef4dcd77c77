"""A tabletop with a formula for its arms, and models that were really fitted to its world."""

from functools import cache
from types import SimpleNamespace
from typing import Any

from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.actions import paper_actions
from cgtorch.domains.knowledge import Knowledge, fit_models, learn
from cgtorch.environment import Dataset
from cgtorch.evolution import EvolutionSettings
from cgtorch.improvement.setup import Setup
from cgtorch.improvement.stopping import Budget
from cgtorch.tabletop.data import Scenes, collect
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.world import Scenarios, TabletopWorld

BASE: Any = SimpleNamespace(description=SimpleNamespace(footprint=FOOTPRINT, name="base"))
"""A robot of which nothing but its footprint is asked."""


def reachable(at: Tensor, table: Tensor) -> Tensor:
    """What is in front of the base and near it can be grasped."""
    return (at[:, 0] > 0.2) & (at[:, 0] < 1.2) & (at[:, 1].abs() < 0.4)


def world_of(scenarios: Scenarios) -> TabletopWorld:
    return TabletopWorld(scenarios, reachable, FOOTPRINT)


class Reaching(Tabletop):
    """The tabletop of that base and these arms."""

    def world(self, scenarios: Scenarios) -> TabletopWorld:
        return TabletopWorld(scenarios, reachable, FOOTPRINT, percept=self.tabletop)


TABLE = Reaching(robot=BASE, networks="percept")


def fitted_to(data: Dataset) -> Knowledge:
    """The tabletop's models of these data."""
    return fit_models(TABLE, data, 0, lambda gamma: None)[0]


@cache
def small_knowledge() -> Knowledge:
    """What is known after 120 transitions and as many grasps."""
    return fitted_to(collect(Scenes(world_of), 120, 120, seeded(0)))


def small_setup() -> Setup[Scenarios]:
    """A small search."""
    return Setup(
        actions=paper_actions(),
        world_of=world_of,
        imagine=imagined,
        learn=learn,
        evolution=EvolutionSettings(population=60, capacity=12),
        budget=Budget(generations=12),
        attempts=3,
        rounds=2,
    )


def imagined(knowledge: Knowledge, scenarios: Scenarios, percepts: Tensor, *given: Any) -> Any:
    """`Imagine` of the table."""
    return TABLE.imagine(knowledge, percepts, *given)
