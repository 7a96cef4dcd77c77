"""Random graphs of many kinds: which ones are kept, in which order."""

import networkx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, seeded

from cgtorch.evolution.population import looping, occurrence, varied_graphs
from cgtorch.graphs import (
    ActionSet,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    Graphs,
    LinearNN,
    RecurrentNN,
    Step,
    to_networkx,
    valid,
)

REWARDED = ActionSet(
    ("Linear", "Aim", "Delay", "Recur", "Branch", "Step"),
    (
        LinearNN(4, 2),
        ContinuousNN(4, 8, 2),
        DelayNN(4, outputs=2),
        RecurrentNN(4, outputs=2),
        BranchingNN(4),
        Step(2),
    ),
)


def kinds(graphs: Graphs) -> list[tuple[int, ...]]:
    return [tuple(sorted(x for x in row if x >= 0)) for row in graphs.action.tolist()]


def test_small_populations_have_all_pairs_of_actions_and_all_of_them_loop() -> None:
    for seed in range(3):
        graphs = varied_graphs(48, REWARDED, 24, (2, 2), seeded(seed))
        assert valid(graphs, REWARDED).all()
        assert looping(graphs).all()
        found = kinds(graphs)
        assert {kind for kind in found if len(kind) == 2} >= {
            (a, b) for a in range(6) for b in range(a + 1, 6)
        }
        assert max(found.count(kind) for kind in set(found)) <= 4


@given(st.integers(0, 2**20), st.integers(1, 30))
def test_looping_is_strongly_connected(seed: int, size: int) -> None:
    actions = custom_actions()
    graphs = varied_graphs(size, actions, 6, (1, 6), seeded(seed))
    assert valid(graphs, actions).all()
    for i, loops in enumerate(looping(graphs).tolist()):
        assert loops == networkx.is_strongly_connected(to_networkx(graphs, actions, i))


def test_what_does_not_loop_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cgtorch.evolution.population.DRAWN", 1)
    loops = looping(varied_graphs(60, custom_actions(), 6, (3, 6), seeded(0))).tolist()
    assert loops == sorted(loops, reverse=True)
    assert True in loops
    assert False in loops


def test_the_order_of_a_group() -> None:
    group = torch.tensor([3, 1, 3, 3, 1, 2])
    assert occurrence(group).tolist() == [0, 0, 1, 2, 1, 0]
    assert occurrence(group[:0]).tolist() == []


def test_the_same_seed_gives_the_same_graphs() -> None:
    one, two = (varied_graphs(10, REWARDED, 5, (2, 4), seeded(7)) for _ in range(2))
    assert (one.action == two.action).all()
    assert (one.parameters == two.parameters).all()
