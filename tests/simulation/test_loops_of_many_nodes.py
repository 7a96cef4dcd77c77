"""Endless loops that change nothing: executed once around where nodes can be told apart."""

from dataclasses import replace

import pytest
import torch
from random_models import models_as, random_models
from support import random_graphs

from cgtorch.graphs import NO_NODE, Graphs
from cgtorch.native import available
from cgtorch.simulation import Rollouts
from cgtorch.simulation.resumable import resumable_rollout
from cgtorch.simulation.rollout import engine_of
from cgtorch.simulation.torch_engine import MOST_IDLE
from cgtorch.tabletop.actions import paper_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

ACTIONS, LIMIT = paper_actions(), 500
BITS = {torch.float32: 32, torch.float64: 64}
"""Nodes that a lane of rollouts in models remembers; one of others remembers 64."""


def loop(count: int, dtype: torch.dtype, back: int = 0) -> Graphs:
    """Nodes that only perceive, of which the last leads back to another one."""
    graphs = random_graphs(0, 1, ACTIONS, capacity=count, nodes=(1, 1))
    edges = torch.full((1, count, graphs.edges.shape[2]), NO_NODE)
    edges[0, :, 0] = torch.arange(1, count + 1)
    edges[0, -1, 0] = back
    action = torch.full((1, count), ACTIONS.names.index("Detect"))
    parameters = torch.zeros(1, count, graphs.parameters.shape[2], dtype=dtype)
    return replace(
        graphs, action=action, edges=edges, parameters=parameters, start=0 * action[:, 0]
    )


def both_ways(graphs: Graphs, dtype: torch.dtype) -> list[Rollouts]:
    environment, some = models_as(random_models(0, 3), dtype), torch.tensor([2])
    engine = engine_of(ACTIONS, environment)
    assert engine is not None
    limits = LIMIT, LIMIT, MOST_IDLE
    resumed = resumable_rollout(graphs, ACTIONS, environment, some, limits, engine)
    found = [engine.rollouts(graphs, some, LIMIT, LIMIT), resumed]
    return [each for each in found if each is not None]


@pytest.mark.parametrize("dtype", BITS)
def test_a_loop_is_executed_once_if_its_nodes_can_be_told_apart(dtype: torch.dtype) -> None:
    for count, back, executed in (
        (1, 0, (2, 2)), (5, 0, (6, 6)), (BITS[dtype], 0, (BITS[dtype] + 1,) * 2),
        (BITS[dtype] + 1, 0, (LIMIT, LIMIT if BITS[dtype] == 64 else BITS[dtype] + 2)),
        (65, 0, (LIMIT, LIMIT)), (70, 66, (70, 70)), (70, 64, (70, 70)), (70, 63, (LIMIT, LIMIT)),
    ):  # fmt: skip
        found = both_ways(loop(count, dtype, back), dtype)
        assert len(found) == 2
        assert tuple(each.executed for each in found) == executed
        for each in found:
            assert each.transitions.tolist() == [[LIMIT]]
            assert bool(each.timed_out.all())
