"""A tabletop with a formula for its arms, and models that were really fitted to its world."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import torch
from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.domains.knowledge import Knowledge
from cgtorch.evolution import EvolutionSettings
from cgtorch.ground.environment import Dataset
from cgtorch.improvement.setup import Budget, Setup
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.data import Scenes, collect
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.stands import graspable_from_somewhere
from cgtorch.tabletop.world import LAB_NOISE, Noise, Scenarios, TabletopWorld

BASE: Any = SimpleNamespace(description=SimpleNamespace(footprint=FOOTPRINT, name="base"))
"""A robot of which nothing but its footprint is asked."""
FRESH_NOISE = Noise(LAB_NOISE.position, LAB_NOISE.heading, repeats=False)


def reachable(at: Tensor, table: Tensor) -> Tensor:
    """What is in front of the base and near it can be grasped."""
    return (at[:, 0] > 0.2) & (at[:, 0] < 1.2) & (at[:, 1].abs() < 0.4)


def world_of(scenarios: Scenarios) -> TabletopWorld:
    return TabletopWorld(scenarios, reachable, FOOTPRINT)


def unrepeatable(scenarios: Scenarios) -> TabletopWorld:
    """The same world, whose noise nothing repeats."""
    return TabletopWorld(scenarios, reachable, FOOTPRINT, FRESH_NOISE)


class Reaching(Tabletop):
    """The tabletop of that base and these arms."""

    def world(self, scenarios: Scenarios) -> TabletopWorld:
        return TabletopWorld(scenarios, reachable, FOOTPRINT, percept=self.tabletop)

    def solvable(self, scenarios: Scenarios) -> Tensor:
        return graspable_from_somewhere(scenarios, FOOTPRINT, reachable)


TABLE = Reaching(robot=BASE, networks="percept")
TABLE_MODELS = TABLE.models(TABLE)


def fitted_to(data: Dataset) -> Knowledge:
    """The tabletop's models of these data."""
    return TABLE_MODELS.fit(data, 0)


@cache
def small_knowledge() -> Knowledge:
    """What is known after 120 transitions and as many grasps."""
    return fitted_to(collect(Scenes(world_of), 120, 120, seeded(0)))


def small_setup() -> Setup[Scenarios]:
    """A small search in the models."""
    return Setup(
        actions=paper_actions(),
        world_of=world_of,
        imagine=imagined,
        learn=TABLE_MODELS.learn,
        evolution=EvolutionSettings(population=60, capacity=12),
        budget=Budget(generations=12),
        attempts=4,
        practice=6,
        looks=16,
        replays=4,
        noisy=True,
    )


def imagined(knowledge: Knowledge, scenarios: Scenarios, percepts: Tensor, *given: Any) -> Any:
    """`Imagine` of the table."""
    return TABLE_MODELS.imagine(knowledge, percepts, *given)


def in_the_world(knowledge: None, scenarios: Scenarios, percepts: Tensor, *given: Any) -> Any:
    """`Imagine` without models: the world itself, where copies have other noise."""
    copies = [scenarios.with_noise(copy) for copy in range(given[0])]
    rows = torch.arange(given[0] * len(scenarios)).view(given[0], -1).T.flatten()
    return world_of(copies[0].joined(*copies[1:])[rows])
