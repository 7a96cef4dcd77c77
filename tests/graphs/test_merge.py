"""Merging nodes that behave the same, and finding skills that do."""

from dataclasses import replace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    all_valid,
    custom_actions,
    model,
    nested_actions,
    random_graphs,
    random_skill,
    same,
    seeded,
    world,
)
from told_by_runs import tensors_of

from cgtorch.graphs import (
    NO_NODE,
    ActionSet,
    Graphs,
    Skill,
    SubSkill,
    concatenate,
    merged,
    pruned,
    same_behaviour,
)
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import Detect, Grasp, MoveBase, paper_actions

SETS = [paper_actions(), custom_actions(), nested_actions(0)]
PLAIN = ActionSet(("MoveBase", "Detect", "Grasp"), (MoveBase(), Detect(), Grasp()))
"""Without parameters many nodes behave the same."""

ANY = st.sampled_from([*SETS, PLAIN])


def doubled(graphs: Graphs, seed: int) -> Graphs:
    """The same graphs with two of every node, edges leading to either."""
    n = graphs.capacity
    edges = graphs.edges.repeat(1, 2, 1)
    other = torch.rand(edges.shape, generator=seeded(seed)) < 0.5
    edges = torch.where((edges != NO_NODE) & other, edges + n, edges)
    action, parameters = graphs.action.repeat(1, 2), graphs.parameters.repeat(1, 2, 1)
    return Graphs(action, edges, parameters, graphs.start)


@given(st.integers(0, 2**31), ANY)
@settings(max_examples=12)
def test_runs_do_not_change(seed: int, actions: ActionSet) -> None:
    graphs = doubled(random_graphs(seed, 8, actions), seed)
    for place in (world(seed, 6), model(seed, 6)):
        was, now = (rollout(g, actions, place) for g in (graphs, merged(graphs)))
        for name, value in tensors_of(was).items():
            assert torch.equal(value, getattr(now, name)), name


@given(st.integers(0, 2**31), ANY)
@settings(max_examples=12)
def test_graphs_never_grow_and_stay_valid(seed: int, actions: ActionSet) -> None:
    graphs = random_graphs(seed, 20, actions)
    small = merged(graphs)
    assert (small.num_nodes <= graphs.num_nodes).all()
    assert all_valid(small, actions)
    assert same(merged(small), small)


def told_apart(graphs: Graphs, index: int) -> int:
    """How many of a graph's nodes differ, two at a time: the plain table-filling algorithm."""
    action, edges = graphs.action[index].tolist(), graphs.edges[index].tolist()
    parameters = graphs.parameters[index].tolist()
    nodes = [i for i, a in enumerate(action) if a != NO_NODE]
    differ = {
        (i, j): action[i] != action[j] or parameters[i] != parameters[j]
        for i in nodes
        for j in nodes
    }
    for _ in nodes:
        for i, j in differ:
            heads = zip(edges[i], edges[j], strict=True)
            differ[i, j] |= any(differ.get(h, False) for h in heads)
    return sum(all(differ[i, j] for j in nodes if j < i) for i in nodes)


@given(st.integers(0, 2**31), ANY)
@settings(max_examples=12)
def test_as_few_nodes_as_pairs_that_are_told_apart(seed: int, actions: ActionSet) -> None:
    graphs = doubled(random_graphs(seed, 4, actions), seed)
    found = merged(graphs).num_nodes.tolist()
    assert found == [told_apart(graphs, i) for i in range(4)]


def test_some_graphs_get_smaller_by_themselves() -> None:
    graphs = random_graphs(0, 100, PLAIN)
    assert (merged(graphs).num_nodes < graphs.num_nodes).sum() > 10


def test_graphs_of_a_batch_do_not_meet() -> None:
    graphs = random_graphs(1, 5, PLAIN)
    alone = [merged(graphs[i : i + 1]) for i in range(5)]
    assert same(merged(concatenate([graphs, graphs])), concatenate([*alone, *alone]))


def test_parameters_are_compared_to_the_last_bit() -> None:
    """Even zeros of either sign, by which an action might divide."""
    actions = paper_actions()
    k = actions.parameter_capacity
    loop = torch.tensor([[[1, 1], [0, 0]]])
    branch = torch.full((1, 2), actions.index("BranchingNN"))
    graphs = Graphs(branch, loop, torch.zeros(1, 2, k), torch.zeros(1, dtype=torch.long))
    assert int(merged(graphs).num_nodes) == 1
    for value in (-0.0, 1e-45):
        parameters = graphs.parameters.clone()
        parameters[0, 1, 3] = value
        assert int(merged(replace(graphs, parameters=parameters)).num_nodes) == 2


@given(st.integers(0, 2**31), st.sampled_from(SETS))
@settings(max_examples=12)
def test_a_skill_behaves_as_its_copy_under_another_name(seed: int, actions: ActionSet) -> None:
    one = random_skill(seed, "one", actions)
    order = torch.randperm(one.graph.capacity, generator=seeded(seed))
    place = order.argsort()
    edges = torch.where(one.graph.edges < 0, NO_NODE, place[one.graph.edges.clamp_min(0)])
    graph = one.graph
    moved = Graphs(
        graph.action[:, order], edges[:, order], graph.parameters[:, order], place[graph.start]
    )
    other = Skill("other", pruned(doubled(moved, seed)), actions)
    assert same_behaviour(one, other)
    assert same_behaviour(other, one)
    assert not same_behaviour(one, replace(other, max_transitions=19))
    assert not same_behaviour(one, random_skill(seed + 1, "one", actions))
    parameters = torch.where(graph.parameters == 0, 0, graph.parameters + 1)
    changed = Skill("one", replace(graph, parameters=parameters), actions)
    assert same_behaviour(one, changed) == torch.equal(parameters, graph.parameters)


def test_skills_in_skills_are_compared_too() -> None:
    base = paper_actions()
    inner, twin, third = (random_skill(s, f"S{s}", base) for s in (0, 0, 1))
    twin = replace(twin, name="twin")
    tops = [base.extended([s.name], [SubSkill(s)]) for s in (inner, twin, third)]
    graph = random_skill(5, "top", tops[0]).graph
    first, second, other = (Skill("top", graph, a) for a in tops)
    assert same_behaviour(first, second)
    assert not same_behaviour(first, other)
