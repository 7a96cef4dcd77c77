"""Rollouts that ranks share: the same bits, and no rank runs everything."""

import pytest
import torch
from support import random_graphs
from torch import Tensor
from walking import CountedPath, FewPaths, path, walking_actions

from cgtorch.graphs import Graphs
from cgtorch.ground import distributed as ranks
from cgtorch.native.rank_processes import in_ranks
from cgtorch.simulation import Rollouts, rollout, shared_rollout

ACTIONS = walking_actions()


def assert_equal(found: Rollouts, wanted: Rollouts) -> None:
    assert found.executed == wanted.executed
    for name, value in vars(wanted).items():
        if isinstance(value, Tensor):
            assert torch.equal(getattr(found, name), value), name


def shared(graphs: Graphs, world: CountedPath, count: int) -> tuple[Rollouts, list[int]]:
    """The rollouts on the first of so many ranks, and the lanes that each of them has begun."""
    found, begun = list[Rollouts](), list[int]()

    def work() -> None:
        found.append(shared_rollout(graphs, ACTIONS, world, max_transitions=60))
        begun.extend(ranks.all_gather(torch.tensor([world.begun]), count).tolist())

    in_ranks(work, count)
    return found[0], begun


@pytest.mark.parametrize(
    ("graphs", "scenarios", "each"),
    [(9, 4, [12, 12, 12]), (2, 10, [6, 6, 8]), (1, 2, [0, 1, 1]), (2, 2, [0, 2, 2])],
)
def test_any_number_of_ranks_gives_the_same_and_shares_the_lanes(
    graphs: int, scenarios: int, each: list[int]
) -> None:
    some, scenes = random_graphs(3, graphs, ACTIONS), path(1, scenarios).scenarios
    wanted = rollout(some, ACTIONS, FewPaths(scenes), max_transitions=60)
    alone, begun = shared(some, FewPaths(scenes), 1)
    assert begun == [graphs * scenarios]
    assert_equal(alone, wanted)
    found, begun = shared(some, FewPaths(scenes), 3)
    assert begun == each
    assert_equal(found, wanted)


def test_where_any_number_of_lanes_run_at_once_all_run_on_each_rank() -> None:
    some, scenes = random_graphs(3, 5, ACTIONS), path(1, 4).scenarios
    found, begun = shared(some, CountedPath(scenes), 2)
    assert begun == [20, 20]
    assert_equal(found, rollout(some, ACTIONS, CountedPath(scenes), max_transitions=60))
