"""Eq. 3 compiled against eq. 3 in torch."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_models
from support import as_double, as_double_actions, nested_actions, random_graphs, seeded

from cgtorch.evolution.fitness import Evaluation, evaluator
from cgtorch.graphs import ActionSet
from cgtorch.ground.numerics import row_means
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.edge_networks import edge_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SETS = [as_double_actions(s) for s in (paper_actions(), nested_actions(0, paper_actions()))]


class InTorch(ModelEnvironment):
    """The same models, but no longer what compiled code knows."""


def both(
    seed: int, actions: ActionSet, keep: torch.Tensor, limit: int, broken: bool = False
) -> tuple[Evaluation, Evaluation]:
    environment = random_models(seed, len(keep))
    graphs = as_double(random_graphs(seed, 9, actions))
    if broken:
        graphs.parameters[2, 0, 0] = torch.nan
        graphs.parameters[3, 0, 1] = torch.inf
        environment.percepts[1, 5] = torch.nan
        environment.first_state[1, 2] = torch.nan
    compiled = evaluator(actions, environment, keep, limit, most_lanes=40)(graphs)
    environment.__class__ = InTorch
    return compiled, evaluator(actions, environment, keep, limit)(graphs)


def assert_same(found: Evaluation, wanted: Evaluation) -> None:
    for each in (found, wanted):
        assert torch.equal(each.fitness, row_means(each.scores))
    assert torch.equal(found.succeeded, wanted.succeeded)
    assert found.transitions == wanted.transitions
    assert found.not_finite == wanted.not_finite
    torch.testing.assert_close(found.scores, wanted.scores, atol=1e-6, rtol=0)
    torch.testing.assert_close(found.fitness, wanted.fitness, atol=1e-6, rtol=0)


@given(
    seed=st.integers(0, 2**31),
    actions=st.sampled_from(SETS),
    share=st.floats(0, 1),
    limit=st.integers(1, 20),
    broken=st.booleans(),
)
@settings(max_examples=50, deadline=None)
def test_compiled_fitness_is_that_of_torch(
    seed: int, actions: ActionSet, share: float, limit: int, broken: bool
) -> None:
    keep = torch.rand(19, generator=seeded(seed)) < share  # more than a vector of lanes
    assert_same(*both(seed, actions, keep, limit, broken))


def test_the_comparison_meets_graphs_that_lose_and_keep_w() -> None:
    keep = torch.zeros(16, dtype=torch.bool)
    environment = random_models(3, 16)
    graphs = as_double(random_graphs(3, 200, SETS[0]))
    solved = evaluator(SETS[0], environment, keep)(graphs).succeeded
    keep[solved.sum(0).argsort(descending=True)[:2]] = True
    found = evaluator(SETS[0], environment, keep)(graphs)
    kept = found.succeeded[:, keep].all(1)
    assert 5 < int(kept.sum()) < 195
    assert bool((found.scores[~kept] == 0).all())
    assert not bool(found.succeeded[~kept][:, ~keep].any())


def test_edge_networks_are_compiled_too() -> None:
    actions = as_double_actions(edge_actions(7))
    assert_same(*both(5, actions, torch.arange(8) < 2, 20))
