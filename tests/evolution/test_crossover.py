from collections import Counter

import networkx as nx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import nested_actions, random_graphs, seeded
from torch import Generator, Tensor

from cgtorch.evolution import Population, compiled
from cgtorch.evolution import operators_in_torch as module
from cgtorch.evolution.operators import crossover
from cgtorch.evolution.operators_in_torch import graft, group, undirected_distance
from cgtorch.graphs import NO_NODE, Graphs, compacted, to_networkx
from cgtorch.ground.counter_rng import keys, random_key, words
from cgtorch.tabletop.actions import paper_actions

ACTIONS = nested_actions()
seeds = st.integers(0, 2**31)


def undirected(graphs: Graphs, index: int) -> "nx.MultiGraph[int | str]":
    return to_networkx(graphs, ACTIONS, index).to_undirected()


def group_of(graphs: Graphs, generator: Generator) -> Tensor:
    own = keys(random_key(generator), len(graphs))[:, None]
    places = torch.arange(1 + graphs.capacity)
    return group(graphs, words(own, places[:1]), words(own, places[1:]))


def grafted(
    host: Graphs, into: Tensor, donor: Graphs, taken: Tensor, k: Tensor, generator: Generator
) -> Graphs:
    heads = torch.rand(host.edges.shape, generator=generator)
    return graft(host, into, donor, taken, k, heads)


def crossing(graphs: Graphs, probability: float = 1.0) -> Population:
    return Population(graphs, torch.full((len(graphs), 8), probability))


@given(seeds)
def test_distance_is_that_of_an_undirected_breadth_first_search(seed: int) -> None:
    graphs = random_graphs(seed, 6, ACTIONS, capacity=14, nodes=(1, 14))
    distance = undirected_distance(graphs, graphs.start)
    for i in range(6):
        wanted = nx.single_source_shortest_path_length(undirected(graphs, i), int(graphs.start[i]))
        found = {j: d for j, d in enumerate(distance[i].tolist()) if d < 14}
        assert found == wanted


@given(seeds)
def test_the_first_of_a_group_are_connected_and_nearest(seed: int) -> None:
    graphs = random_graphs(seed, 6, ACTIONS, capacity=14, nodes=(1, 14))
    found = group_of(graphs, seeded(seed))
    for i in range(6):
        view, order = undirected(graphs, i), found[i].tolist()
        assert sorted(order) == list(range(14))
        far = nx.single_source_shortest_path_length(view, order[0])
        nodes = order[: len(view)]
        assert set(nodes) == set(view)
        assert [far[n] for n in nodes] == sorted(far.values())
        for k in range(1, len(view) + 1):
            assert nx.is_connected(view.subgraph(nodes[:k]))


def test_a_group_may_begin_anywhere() -> None:
    graphs = random_graphs(0, 1, ACTIONS, nodes=(8, 8))
    many = graphs[torch.zeros(2000, dtype=torch.long)]
    first = Counter(group_of(many, seeded(0))[:, 0].tolist())
    n = int(graphs.num_nodes[0])
    assert len(first) == n
    assert all(abs(count - 2000 / n) < 5 * (2000 / n) ** 0.5 for count in first.values())


@given(seeds, st.integers(0, 7))
def test_a_graft_is_what_the_groups_say(seed: int, k: int) -> None:
    """Against a plain reference, node by node."""
    host = random_graphs(seed, 4, ACTIONS, nodes=(8, 12))
    donor = random_graphs(seed + 1, 4, ACTIONS, nodes=(8, 12))
    size = torch.minimum(host.num_nodes, donor.num_nodes).clamp_max(k)
    a, b = group_of(host, seeded(seed)), group_of(donor, seeded(seed + 1))
    child = grafted(host, a, donor, b, size, seeded(seed))
    for i in range(4):
        into, taken = a[i, : size[i]].tolist(), b[i, : size[i]].tolist()
        place = dict(zip(taken, into, strict=True))
        nodes = set(host.used[i].nonzero()[:, 0].tolist())
        assert set(child.used[i].nonzero()[:, 0].tolist()) == nodes
        assert child.start[i] == host.start[i]
        for node in nodes:
            if node not in into:
                for name in ("action", "edges", "parameters"):
                    assert torch.equal(getattr(child, name)[i, node], getattr(host, name)[i, node])
        for old, new in place.items():
            assert child.action[i, new] == donor.action[i, old]
            assert torch.equal(child.parameters[i, new], donor.parameters[i, old])
            edges = zip(child.edges[i, new].tolist(), donor.edges[i, old].tolist(), strict=True)
            for head, before in edges:
                if before == NO_NODE:
                    assert head == NO_NODE
                elif before in place:
                    assert head == place[before]
                else:
                    assert head in nodes


def test_edges_that_leave_a_group_go_to_random_nodes() -> None:
    host, donor = (random_graphs(s, 1, ACTIONS, nodes=(10, 10)) for s in (0, 3))
    many = torch.zeros(3000, dtype=torch.long)
    group_a, group_b = (group_of(g, seeded(1)).expand(3000, -1) for g in (host, donor))
    child = grafted(host[many], group_a, donor[many], group_b, torch.ones_like(many), seeded(0))
    taken, into = int(group_b[0, 0]), int(group_a[0, 0])
    leaves = [j for j, h in enumerate(donor.edges[0, taken].tolist()) if h not in (NO_NODE, taken)]
    assert leaves
    heads = Counter(child.edges[:, into, leaves[0]].tolist())
    n = int(host.num_nodes[0])
    assert len(heads) == n
    assert all(abs(count - 3000 / n) < 5 * (3000 / n) ** 0.5 for count in heads.values())


@pytest.fixture
def unpruned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "takes", lambda *_: False)  # which prunes, too
    monkeypatch.setattr(module, "pruned", lambda graphs: graphs)


@pytest.mark.usefixtures("unpruned")
def test_k_is_uniform_from_one_to_half_of_the_smaller_parent() -> None:
    pairs = 4000
    actions = paper_actions()
    many = random_graphs(5, 600, actions, capacity=16, nodes=(9, 16))
    small, large = (int((many.num_nodes == n).nonzero()[0, 0]) for n in (9, 13))
    which = torch.zeros(pairs, dtype=torch.long)
    a, b = many[which + small], many[which + large]
    a.parameters[:], b.parameters[:] = 1.0, 2.0  # to tell whose node it is
    for first, second in ((a, b), (b, a)):
        children = crossover(crossing(first), crossing(second), seeded(0)).graphs
        own = first.parameters[0, 0, 0]
        swapped = (children.used & (children.parameters[..., 0] != own))[:pairs].sum(1)
        back = (children.used & (children.parameters[..., 0] == own))[pairs:].sum(1)
        assert torch.equal(swapped, back)
        counts = torch.bincount(swapped)
        assert counts[0] == 0
        assert len(counts) == 5  # 1 … 9 // 2
        assert ((counts[1:] - pairs / 4).abs() < 5 * (pairs / 4) ** 0.5).all()


@given(seeds)
def test_parameters_are_never_mixed_within_a_node(seed: int) -> None:
    first, second = (random_graphs(seed + i, 8, ACTIONS, nodes=(4, 12)) for i in range(2))
    children = crossover(crossing(first), crossing(second), seeded(seed)).graphs
    known = {
        (int(action), tuple(row))
        for g in (first, second)
        for action, row in zip(g.action.flatten(), g.parameters.flatten(0, 1).tolist(), strict=True)
    }
    kept = children.used.flatten()
    for action, row in zip(
        children.action.flatten()[kept],
        children.parameters.flatten(0, 1)[kept].tolist(),
        strict=True,
    ):
        assert (int(action), tuple(row)) in known


def test_pairs_cross_with_the_mean_of_their_probabilities() -> None:
    which = torch.zeros(4000, dtype=torch.long)
    graphs = random_graphs(0, 1, ACTIONS, nodes=(10, 10))[which]
    other = random_graphs(1, 1, ACTIONS, nodes=(10, 10))[which]
    children = crossover(crossing(graphs, 0.9), crossing(other, 0.1), seeded(0)).graphs[:4000]
    graphs = compacted(graphs)
    crossed = (children.parameters != graphs.parameters).flatten(1).any(1)
    crossed |= (children.action != graphs.action).any(1) | (children.edges != graphs.edges).any(
        2
    ).any(1)
    assert crossed.float().mean() == pytest.approx(0.5, abs=0.05)
