from dataclasses import replace

import networkx as nx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, is_valid, nested_actions, random_graphs, same, seeded
from walking import chain

from cgtorch.graphs import (
    NO_NODE,
    Graphs,
    Skill,
    check_graph,
    compacted,
    concatenate,
    from_networkx,
    pruned,
    reachable,
    resized,
    to_networkx,
    valid,
)
from cgtorch.ground.errors import GraphError

ACTIONS = custom_actions()
seeds = st.integers(0, 2**31)


def scattered(seed: int) -> Graphs:
    """Graphs whose every outcome has an edge, but whose nodes need not all be reachable."""
    generator = seeded(seed)
    action = torch.randint(len(ACTIONS), (6, 10), generator=generator)
    action[torch.rand(6, 10, generator=generator) < 0.3] = NO_NODE
    action[:, 0] = ACTIONS.index("Counter")
    used = action != NO_NODE
    edges = torch.multinomial(used.float(), 30, replacement=True, generator=generator).view(
        6, 10, 3
    )
    edges[~(ACTIONS.has_edge[action.clamp_min(0)] & used[..., None])] = NO_NODE
    return Graphs(action, edges, torch.zeros(6, 10, 36), torch.zeros(6, dtype=torch.long))


@given(seeds)
def test_reachability_and_pruning_against_networkx(seed: int) -> None:
    graphs = scattered(seed)
    reached, kept = reachable(graphs), pruned(graphs)
    for i in range(len(graphs)):
        view = to_networkx(graphs, ACTIONS, i)
        start = view.graph["start"]
        wanted = nx.descendants(view, start) | {start}
        assert set(reached[i].nonzero()[:, 0].tolist()) == wanted
        assert is_valid(kept, ACTIONS, i)
        rest = view.subgraph(wanted)
        assert nx.utils.graphs_equal(to_networkx(kept, ACTIONS, i), nx.MultiDiGraph(rest))


@given(seeds, st.data())
def test_valid_and_check_graph_agree_with_the_plain_rule(seed: int, data: st.DataObject) -> None:
    """Random damage: both must see exactly what is really wrong."""
    graphs = random_graphs(seed, 1, ACTIONS, capacity=6, nodes=(3, 6))
    if data.draw(st.booleans()):
        slot = data.draw(st.integers(0, 5))
        outcome = data.draw(st.integers(0, 2))
        graphs.edges[0, slot, outcome] = data.draw(st.integers(-3, 8))
    if data.draw(st.booleans()):
        graphs.action[0, data.draw(st.integers(0, 5))] = data.draw(st.integers(-3, 8))
    if data.draw(st.booleans()):
        graphs.start[0] = data.draw(st.integers(-3, 8))
    parameters = torch.zeros_like(graphs.parameters)  # of which valid() takes no notice
    graphs = replace(graphs, parameters=parameters)
    wanted = is_valid(graphs, ACTIONS)
    assert bool(valid(graphs, ACTIONS)[0]) == wanted
    if wanted:
        check_graph(graphs, ACTIONS)
    else:
        with pytest.raises(GraphError):
            check_graph(graphs, ACTIONS)


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("start", (0,), 7, "start node 7 does not exist; nodes are"),
        ("edges", (0, 1, 1), -1, r"node 1 \(Grasp\) has no edge for outcome 'failure' \(head -1\)"),
        ("edges", (0, 1, 0), 2, "node 1 has an edge to 2 for outcome 'success', which is terminal"),
        ("edges", (0, 0, 2), 1, "node 0 has an edge to 1 for outcome 2, which is terminal or does"),
        ("edges", (0, 1, 1), 0, "node 2 cannot be reached from the start; remove or connect it"),
        ("action", (0, 1), 99, "node 1 has action 99; the set has 6"),
        ("action", (0, 1), 6, "node 1 has action 6; the set has 6"),
        ("action", (0, 1), -2, "node 1 has action -2; the set has 6"),
        (
            "parameters",
            (0, 2, 3),
            torch.nan,
            "node 2 has parameters that are not finite; give numb",
        ),
    ],
)
def test_what_check_graph_says(
    name: str, place: tuple[int, ...], value: float, message: str
) -> None:
    graphs = chain(ACTIONS, "Detect", "Grasp", "ContinuousNN")
    check_graph(graphs, ACTIONS)
    getattr(graphs, name)[place] = value
    with pytest.raises(GraphError, match=message):
        check_graph(graphs, ACTIONS)
    with pytest.raises(GraphError, match=message):
        Skill("broken", graphs, ACTIONS)


@given(seeds)
def test_view_round_trip(seed: int) -> None:
    actions = nested_actions()
    graphs = random_graphs(seed, 5, actions)
    again = concatenate(
        [from_networkx(to_networkx(graphs, actions, i), actions, 12) for i in range(5)]
    )
    assert same(again, compacted(graphs))


def test_the_view_says_what_the_paper_draws() -> None:
    view = to_networkx(chain(ACTIONS, "Detect", "Grasp", "ContinuousNN"), ACTIONS)
    labels = nx.get_node_attributes(view, "label")
    assert labels == {0: "Detect_0", 1: "Grasp_1", 2: "ContinuousNN_2"}
    assert view.graph["start"] == 0
    assert sorted(view.edges(data="outcome")) == [
        (0, 1, "success"),
        (1, 2, "failure"),
        (2, 0, "success"),
    ]


def test_parallel_edges_are_kept() -> None:
    graphs = from_networkx(to_networkx(chain(ACTIONS, "MoveBase"), ACTIONS), ACTIONS)
    assert graphs.edges[0, 0].tolist() == [0, 0, NO_NODE]
    assert to_networkx(graphs, ACTIONS).number_of_edges(0, 0) == 2


@given(seeds)
def test_compacting_keeps_the_graph_and_moves_it_to_the_front(seed: int) -> None:
    graphs = pruned(scattered(seed))
    front = compacted(graphs)
    assert same(compacted(front), front)
    for i in range(len(graphs)):
        n = int(graphs.num_nodes[i])
        assert front.used[i, :n].all()
        assert not front.used[i, n:].any()
        slots = graphs.used[i].nonzero()[:, 0].tolist()
        old = nx.relabel_nodes(
            to_networkx(graphs, ACTIONS, i), {slot: j for j, slot in enumerate(slots)}
        )
        new = to_networkx(front, ACTIONS, i)
        assert new.graph["start"] == slots.index(int(graphs.start[i]))
        assert set(old.edges(data="outcome")) == set(new.edges(data="outcome"))
        assert [a for _, a in old.nodes(data="action")] == [a for _, a in new.nodes(data="action")]


def test_resizing_grows_and_refuses_to_cut() -> None:
    graphs = compacted(random_graphs(0, 5, ACTIONS, capacity=12, nodes=(4, 8)))
    bigger = resized(graphs, 20, 5, 50)
    assert bigger.edges.shape == (5, 20, 5)
    assert bigger.parameters.shape == (5, 20, 50)
    assert same(resized(bigger, 12, 3, 36), graphs)
    fewest = int(graphs.num_nodes.max())
    resized(graphs, fewest, 3, 36)
    for shape in ((fewest - 1, 3, 36), (12, 1, 36), (12, 3, 5)):
        with pytest.raises(GraphError, match="do not fit"):
            resized(graphs, *shape)
