"""Random graphs of many kinds for first populations, and which of them act for ever."""

import networkx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, same, seeded
from torch import Generator, Tensor
from walking import chain

from cgtorch.evolution.first_graphs import (
    lasting,
    looping,
    occurrence,
    random_graphs,
    varied_graphs,
)
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

ACTIONS = custom_actions()
SENDING = {"Linear", "Aim", "Delay", "Recur", "ContinuousNN", "Counter"}
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


class Counts(LinearNN):
    """Counts for how many nodes parameters are drawn, by its name."""

    def __init__(self, name: str, counts: dict[str, int]) -> None:
        super().__init__(20, 2)
        self.name, self.counts = name, counts

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        self.counts[self.name] += n
        return super().initial_parameters(n, generator)


def kinds(graphs: Graphs) -> list[tuple[int, ...]]:
    return [tuple(sorted(x for x in row if x >= 0)) for row in graphs.action.tolist()]


def test_a_seed_says_which_varied_graphs_there_are() -> None:
    one, again, other = (varied_graphs(20, ACTIONS, 8, (2, 5), seeded(s)) for s in (0, 0, 1))
    assert same(one, again)
    assert not same(one, other)


def test_small_populations_have_all_pairs_that_act_equally_often_and_nothing_else() -> None:
    """Of each pair, four act by what was seen first only."""
    for seed in range(10):
        graphs = varied_graphs(48, REWARDED, 24, (2, 2), seeded(seed))
        assert valid(graphs, REWARDED).all()
        loops = looping(graphs, REWARDED)
        assert lasting(graphs, REWARDED).all()
        for some, count in ((graphs[loops], 8), (graphs[~loops], 4)):
            found = kinds(some)
            assert {kind: found.count(kind) for kind in found} == {(a, 5): count for a in range(4)}
        assert loops[:4].all()


def test_without_steps_all_strongly_connected_graphs_loop() -> None:
    actions = ActionSet(REWARDED.names[:4], REWARDED.actions[:4])
    found = kinds(varied_graphs(48, actions, 24, (2, 2), seeded(0)))
    assert set(found) == {(a, b) for a in range(4) for b in range(a, 4)} | {(a,) for a in range(4)}


@given(st.integers(0, 2**20), st.sampled_from([custom_actions(), REWARDED]))
def test_looping_is_strongly_connected_by_edges_that_are_followed(
    seed: int, actions: ActionSet
) -> None:
    graphs = random_graphs(30, actions, 6, (1, 6), seeded(seed))
    for i, loops in enumerate(looping(graphs, actions).tolist()):
        whole = to_networkx(graphs, actions, i)
        steps = {node for node, name in whole.nodes(data="action") if name in ("Step", "MoveBase")}
        failures = [e for e in whole.edges(keys=True) if e[0] in steps and e[2] == "failure"]
        others = [e for e in whole.edges(keys=True) if e[0] in steps and e[2] == "success"]
        later, first = whole.copy(), whole.copy()
        later.remove_edges_from(failures)
        first.remove_edges_from(others)
        begins = {*networkx.descendants(first, whole.graph["start"]), whole.graph["start"]}
        sends = any(whole.nodes[node]["action"] in SENDING for node in begins)
        assert loops == (networkx.is_strongly_connected(later) and sends and bool(steps))


@pytest.mark.parametrize(
    ("names", "edges", "loops", "lasts"),
    [
        (("Aim", "Step"), {}, True, True),
        (("Aim", "Linear"), {}, False, False),  # says much and does nothing
        (("Step", "Branch"), {}, False, False),  # does nothing, as nothing is said
        (("Aim", "Step"), {(1, "failure"): 1}, True, True),  # there is a message by then
        (("Aim", "Step"), {(1, "success"): 1}, False, True),  # only the first percept counts
        (("Step", "Aim"), {}, True, True),  # the first step fails, as there is no message yet
        (("Step", "Aim"), {(0, "failure"): 0}, False, False),  # and fails for ever
        (("Aim", "Step", "Linear"), {(2, "success"): 2}, False, False),  # acts once, then talks
        (
            ("Branch", "Aim", "Step"),
            {(0, "out1"): 1, (0, "out2"): 2, (2, "failure"): 2}, True, True,
        ),
    ],
)  # fmt: skip
def test_what_is_a_loop_where_steps_do_not_fail(
    names: tuple[str, ...], edges: dict[tuple[int, str], int], loops: bool, lasts: bool
) -> None:
    graph = chain(REWARDED, *names, edges=edges)
    assert looping(graph, REWARDED).tolist() == [loops]
    assert lasting(graph, REWARDED).tolist() == [lasts]


def test_only_the_parameters_of_kept_graphs_are_drawn() -> None:
    counts = dict.fromkeys(REWARDED.names, 0)
    counted = [Counts(name, counts) for name in ("Linear", "Aim")]
    actions = ActionSet((*[each.name for each in counted], "Step"), (*counted, Step(2)))
    graphs = varied_graphs(24, actions, 8, (2, 2), seeded(0))
    for i, name in enumerate(actions.names[:2]):
        assert counts[name] == int((graphs.action == i).sum()) > 0
        drawn = graphs.parameters[graphs.action == i]
        assert drawn.std().item() == pytest.approx(1, abs=0.1)
    assert (graphs.parameters[graphs.action < 0] == 0).all()
    assert (graphs.parameters[graphs.action == 2] == 0).all()


def test_what_does_not_loop_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cgtorch.evolution.first_graphs.DRAWN", 1)
    actions = custom_actions()
    loops = looping(varied_graphs(60, actions, 6, (3, 6), seeded(0)), actions).tolist()
    assert loops == sorted(loops, reverse=True)
    assert True in loops
    assert False in loops


def test_the_order_of_a_group() -> None:
    group = torch.tensor([3, 1, 3, 3, 1, 2])
    assert occurrence(group).tolist() == [0, 0, 1, 2, 1, 0]
    assert occurrence(group[:0]).tolist() == []
