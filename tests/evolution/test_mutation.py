import math
from collections import Counter
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, random_graphs, same, seeded
from torch import Generator, Tensor

from cgtorch.evolution import STRATEGY, Population, initial_strategy
from cgtorch.evolution.operators import mutate, offspring, perturb_parameters, with_new_origins
from cgtorch.evolution.operators_in_torch import (
    add_node,
    change_edges,
    delete_node,
    new_start,
    replace_nodes,
    with_origins,
)
from cgtorch.evolution.population import TAU
from cgtorch.graphs import NO_NODE, ActionSet, Graphs, compacted
from cgtorch.tabletop.actions import Detect

ACTIONS = custom_actions()
seeds = st.integers(0, 2**31)
P = 8
ALWAYS = torch.ones(P)


def graphs_of(seed: int) -> Graphs:
    return random_graphs(seed, P, ACTIONS, capacity=12, nodes=(1, 12))


def draws(graphs: Graphs, columns: int, seed: int) -> Tensor:
    return torch.rand(len(graphs), columns, generator=seeded(seed))


def head_draws(graphs: Graphs, seed: int) -> Tensor:
    return torch.rand(graphs.edges.shape, generator=seeded(seed + 1))


def edges_of(graphs: Graphs, index: int) -> dict[tuple[int, int], int]:
    """Heads by (node, outcome)."""
    rows = enumerate(graphs.edges[index].tolist())
    return {(i, j): h for i, row in rows for j, h in enumerate(row) if h != NO_NODE}


@given(seeds)
def test_add_node_takes_over_one_edge_of_a_node_with_two(seed: int) -> None:
    old = graphs_of(seed)
    new = add_node(old, ACTIONS, ALWAYS, draws(old, 3 + old.edges.shape[2], seed))
    for i in range(P):
        before, after = edges_of(old, i), edges_of(new, i)
        indegree = Counter(before.values())
        nodes = set(old.used[i].nonzero()[:, 0].tolist())
        if len(nodes) == 12 or max(indegree.values(), default=0) < 2:
            assert after == before
            continue
        (added,) = set(new.used[i].nonzero()[:, 0].tolist()) - nodes
        (changed,) = [edge for edge in before if after[edge] != before[edge]]
        assert indegree[before[changed]] >= 2
        assert after[changed] == added
        assert all(h in nodes for (tail, _), h in after.items() if tail == added)
        assert new.start[i] == old.start[i]


@given(seeds)
def test_delete_node_turns_edges_to_others_and_leaves_two(seed: int) -> None:
    old = graphs_of(seed)
    new = delete_node(old, ALWAYS, draws(old, 3, seed), head_draws(old, seed))
    for i in range(P):
        before, after = edges_of(old, i), edges_of(new, i)
        nodes, rest = (set(g.used[i].nonzero()[:, 0].tolist()) for g in (old, new))
        if len(nodes) <= 2:
            assert after == before
            continue
        (gone,) = nodes - rest
        assert set(after) == {edge for edge in before if edge[0] != gone}
        for edge, head in after.items():
            assert head in rest
            assert before[edge] in (head, gone)
        assert int(new.start[i]) in rest
        assert int(old.start[i]) in (int(new.start[i]), gone)


def test_every_node_is_deleted_equally_often() -> None:
    many = random_graphs(2, 1, ACTIONS, nodes=(10, 10))[torch.zeros(3000, dtype=torch.long)]
    n = int(many.num_nodes[0])
    new = delete_node(many, torch.ones(3000), draws(many, 3, 0), head_draws(many, 0))
    gone = (many.used & ~new.used).sum(0)[many.used[0]]
    assert ((gone - 3000 / n).abs() < 5 * (3000 / n) ** 0.5).all()


@given(seeds)
def test_replace_nodes_keeps_only_the_places(seed: int) -> None:
    old = graphs_of(seed)
    new = replace_nodes(old, ACTIONS, ALWAYS, draws(old, old.capacity, seed), head_draws(old, seed))
    assert torch.equal(new.used, old.used)
    assert torch.equal(new.start, old.start)
    assert (new.parameters == 0).all()
    without = replace(new, parameters=torch.zeros(P, 12, 1, dtype=torch.long))
    numbered, first = with_new_origins(without, ACTIONS.standard)
    rates = initial_strategy(P)
    made = perturb_parameters(numbered, first, old.parameters, ACTIONS, rates, P, seeded(seed), 0.1)
    assert torch.equal(made.strategy, rates)
    made = made.graphs
    real = new.used & (ACTIONS.num_parameters[new.action.clamp_min(0)] > 0)
    assert (made.parameters != old.parameters).any(2)[real].all()
    assert (made.parameters[~real] == 0).all()


def test_replaced_nodes_take_every_action_equally_often() -> None:
    many = random_graphs(2, 1, ACTIONS, nodes=(10, 10))[torch.zeros(3000, dtype=torch.long)]
    new = replace_nodes(
        many, ACTIONS, torch.ones(3000), draws(many, many.capacity, 0), head_draws(many, 0)
    )
    count = torch.bincount(new.action[new.used], minlength=len(ACTIONS))
    wanted = count.sum() / len(ACTIONS)
    assert ((count - wanted).abs() < 5 * wanted.sqrt()).all()


@given(seeds)
def test_change_edges_gives_at_most_one_new_head_to_a_node(seed: int) -> None:
    old = graphs_of(seed)
    new = change_edges(old, ALWAYS, draws(old, old.capacity, seed), head_draws(old, seed))
    differs = (new.edges != old.edges).sum(2)
    assert int(differs.max()) <= 1
    assert torch.equal(new.action, old.action)
    assert torch.equal(new.start, old.start)
    assert torch.equal(new.parameters, old.parameters)


def test_change_edges_reaches_every_edge_and_every_head() -> None:
    one = random_graphs(2, 1, ACTIONS, nodes=(10, 10))
    many = one[torch.zeros(5000, dtype=torch.long)]
    new = change_edges(many, torch.ones(5000), draws(many, many.capacity, 0), head_draws(many, 0))
    for (tail, outcome), head in edges_of(one, 0).items():
        heads = set(new.edges[:, tail, outcome].tolist())
        assert heads == set(one.used[0].nonzero()[:, 0].tolist()), (tail, outcome, head)


def test_parameters_move_by_a_gaussian_of_the_individuals_own_size_and_rate() -> None:
    one = random_graphs(2, 1, ACTIONS, nodes=(10, 10))
    many = one[torch.zeros(4000, dtype=torch.long)]
    sigma = torch.where(torch.arange(4000) < 2000, 0.1, 3.0)
    rate = torch.where(torch.arange(4000) % 2 == 0, 0.25, 1.0)
    strategy = initial_strategy(4000)
    strategy[:, STRATEGY.index("mutate_parameter")] = rate
    strategy[:, STRATEGY.index("sigma")] = sigma
    none = [0] * (len(ACTIONS) + 1)
    whole, old = with_origins(many), many.parameters
    new = perturb_parameters(whole, none, old, ACTIONS, strategy, 0, seeded(0), TAU).graphs
    change = new.parameters - many.parameters
    count = ACTIONS.num_parameters[one.action[0].clamp_min(0)] * one.used[0]
    real = torch.arange(change.shape[2]) < count[:, None]
    assert (change[:, ~real] == 0).all()
    change = change[:, real]
    moved = change != 0
    assert moved[0::2].float().mean() == pytest.approx(0.25, abs=0.01)
    assert moved[1::2].float().mean() == pytest.approx(1.0, abs=1e-3)
    for half, size in ((slice(0, 2000), 0.1), (slice(2000, 4000), 3.0)):
        steps = change[half][moved[half]]
        assert steps.mean() == pytest.approx(0.0, abs=0.02 * size)
        assert steps.std() == pytest.approx(size, rel=0.02)
        within = (steps.abs() < size).float().mean()
        assert within == pytest.approx(math.erf(0.5**0.5), abs=0.01)  # Gaussian, not uniform


@given(seeds)
def test_a_new_start_leads_to_another_node(seed: int) -> None:
    old = graphs_of(seed)
    new = new_start(old, ALWAYS, draws(old, 2, seed))
    for i in range(P):
        leads = {tail for (tail, _), head in edges_of(old, i).items() if head != tail}
        assert int(new.start[i]) in (leads or {int(old.start[i])})
    assert same(Graphs(new.action, new.edges, new.parameters, old.start), old)


def test_mutate_uses_each_individuals_own_rates() -> None:
    """One rate at a time is 1: only what it stands for changes."""
    many = random_graphs(2, 1, ACTIONS, nodes=(10, 10))[torch.zeros(200, dtype=torch.long)]
    many = compacted(many)
    for name in STRATEGY[1:-1]:
        strategy = torch.zeros(200, len(STRATEGY))
        strategy[:100, STRATEGY.index(name)] = 1.0
        strategy[:, STRATEGY.index("sigma")] = 1.0
        new = mutate(Population(many, strategy), ACTIONS, seeded(0)).graphs
        assert same(new[100:], many[100:]), name
        changed = {
            field: bool((getattr(new, field)[:100] != getattr(many, field)[:100]).any())
            for field in ("action", "edges", "parameters", "start")
        }
        if name == "mutate_parameter":
            assert [field for field, differs in changed.items() if differs] == ["parameters"]
        elif name == "new_start":
            assert changed["start"]
        else:
            assert changed["edges"], name


class Own(Detect):
    """An action whose parameters begin at 5, 6 and 7."""

    num_parameters = 3

    def initial_parameters(self, count: int, generator: Generator) -> Tensor:
        return torch.tensor([5.0, 6.0, 7.0]).repeat(count, 1)


def test_new_nodes_of_an_action_begin_as_it_says() -> None:
    actions = ActionSet(("Own", *ACTIONS.names), (Own(), *ACTIONS.actions))
    graphs = random_graphs(0, 200, actions, capacity=12, nodes=(2, 9))
    parents = Population(
        replace(graphs, parameters=torch.zeros_like(graphs.parameters)), initial_strategy(200)
    )
    rows = torch.arange(200)
    made = offspring(parents, rows[:0], rows, actions, seeded(1), 12, tau=1e-9).graphs
    of_own = made.parameters[made.action == actions.index("Own")][:, :3]
    new = of_own.mean(1) > 3  # the old ones begin at 0, and all are perturbed
    assert 0 < new.sum() < len(new) / 2
    for kind, wanted in ((new, [5.0, 6.0, 7.0]), (~new, [0.0, 0.0, 0.0])):
        assert torch.allclose(of_own[kind].median(0).values, torch.tensor(wanted), atol=0.5)
