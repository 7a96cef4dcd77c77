"""A stand-in for the arms, a world of it, and models that were really fitted to it."""

import pytest
import torch
from support import FOOTPRINT, seeded
from torch import Tensor

from cgtorch.actions import paper_actions
from cgtorch.tabletop.data import collect
from cgtorch.evolution import EvolutionSettings
from cgtorch.domains.knowledge import Knowledge, fit_models, learn, with_footprint
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.stopping import Budget
from cgtorch.tabletop.world import Scenarios, TabletopWorld, stage_scenarios


def reachable(at: Tensor, table: Tensor) -> Tensor:
    """What is in front of the base and near it can be grasped."""
    return (at[:, 0] > 0.2) & (at[:, 0] < 1.2) & (at[:, 1].abs() < 0.4)


def world_of(scenarios: Scenarios) -> TabletopWorld:
    return TabletopWorld(scenarios, reachable, FOOTPRINT)


@pytest.fixture(scope="session")
def knowledge() -> Knowledge:
    return fit_models(collect(world_of, 120, 120, seeded(0)), seed=0)


@pytest.fixture(scope="session")
def setup() -> Setup:
    """A small search."""
    return Setup(
        actions=paper_actions(),
        world_of=world_of,
        imagine=with_footprint(torch.tensor(FOOTPRINT)),
        learn=learn,
        evolution=EvolutionSettings(population=60, capacity=12),
        budget=Budget(generations=12),
        attempts=3,
        rounds=2,
    )


@pytest.fixture(scope="session")
def nothing_yet(knowledge: Knowledge) -> Progress:
    """Before the first stage."""
    none = stage_scenarios("near", 0)
    return Progress(None, none, none, knowledge)
