"""Compiled routes around tables and boxes beside those of torch, by where they lead in a model."""

from dataclasses import replace

import pytest
import torch
from random_models import random_models
from support import FOOTPRINT, seeded
from test_compiled_rollouts import compiled, run_in_torch
from torch import Tensor
from walking import chain

from cgtorch.native import available
from cgtorch.tabletop.edge_networks import edge_way_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SCENARIOS, GOALS = 40, 24


def reached(scene: tuple[str, int], seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Percepts after first motions to random poses, compiled and in torch, and the first ones."""
    environment = random_models(seed, SCENARIOS, *scene, errors=False)
    environment.most_novel = 2.0  # so that nobody is lost
    actions = edge_way_actions(environment.percept_size, FOOTPRINT)
    graphs = chain(actions, "EdgeWayNN", "MoveBase", "Grasp")[torch.zeros(GOALS, dtype=torch.long)]
    count = actions.actions[actions.index("EdgeWayNN")].num_parameters
    parameters = torch.zeros(graphs.parameters.shape, dtype=torch.float64)
    pose = torch.rand(GOALS, 3, generator=seeded(seed)).double() * 2 - 1
    parameters[:, 0, count - 3 : count] = pose * torch.tensor([2.0, 2.0, 3.0]).double()
    about = replace(graphs, parameters=parameters), actions, environment, torch.arange(SCENARIOS)
    start = environment.percepts.expand(GOALS, -1, -1)
    return compiled(*about, 3).percept, run_in_torch(*about, 3).percept, start


@pytest.mark.parametrize("scene", [("box", 0), ("yaw", 0), ("box", 1), ("yaw", 3)])
def test_first_motions_of_routes_are_those_of_torch(scene: tuple[str, int]) -> None:
    found, wanted, start = reached(scene, 1)
    assert float((found != start).any(2).double().mean()) > 0.5
    torch.testing.assert_close(found, wanted, atol=1e-9, rtol=0)
