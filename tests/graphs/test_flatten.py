"""A flattened skill: one graph of primitive actions, and what cannot be flattened."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    Visits,
    as_double,
    as_double_actions,
    custom_actions,
    endless_actions,
    is_valid,
    model,
    nested_actions,
    random_skill,
    same,
    world,
)
from walking import chain

from cgtorch.graphs import (
    ActionSet,
    Skill,
    SubSkill,
    flattened,
    merged,
    same_behaviour,
)
from cgtorch.ground.environment import Environment
from cgtorch.ground.errors import GraphError
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import Detect, Grasp, paper_actions

limits = st.sampled_from([(2, 4, 6), (3, 5, 20), (20, 20, 20), (30, 2, 7), (60, 60, 60)])
"""Of the innermost, middle and outermost level."""


def nested(seed: int, limits: tuple[int, int, int]) -> Skill:
    """A random skill on three levels; only what ends the whole may end it without success."""
    actions = nested_actions(seed, endless_actions(), limits[:2])
    actions = actions.extended(["Counter"], [custom_actions().actions[-1]])
    actions = as_double_actions(actions)
    skill = random_skill(seed + 2, "top", actions, limits[2])
    return replace(skill, graph=as_double(skill.graph))


@given(
    seed=st.integers(0, 2**31),
    limits=limits,
    most=st.integers(1, 40),
    place=st.sampled_from([world, model]),
)
@settings(max_examples=40)
def test_all_runs_are_the_same(
    seed: int, limits: tuple[int, int, int], most: int, place: Callable[..., Environment]
) -> None:
    skill, environment = nested(seed, limits), place(seed, 8, dtype=torch.float64)
    flat = flattened(skill, most)
    assert flat.max_transitions == most
    once = rollout(
        skill.graph, skill.actions, environment, max_transitions=limits[2], max_steps=most
    )
    again = rollout(flat.graph, flat.actions, environment, max_transitions=most)
    for name in ("succeeded", "timed_out", "percept", "state"):
        assert torch.equal(getattr(once, name), getattr(again, name)), name
    # Where the outermost level runs out, the flat skill idles up to its own limit.
    count = torch.where(once.timed_out, most, once.transitions)
    assert torch.equal(again.transitions, count)


@given(seed=st.integers(0, 2**31), limits=limits, most=st.integers(1, 40))
@settings(max_examples=40)
def test_a_flat_skill_is_one_valid_graph_of_primitive_actions(
    seed: int, limits: tuple[int, int, int], most: int
) -> None:
    skill = nested(seed, limits)
    flat = flattened(skill, most)
    assert is_valid(flat.graph, flat.actions)
    assert flat.name == skill.name
    assert flat.depth == 1
    assert not any(isinstance(a, SubSkill) for a in flat.actions.actions)
    assert same(merged(flat.graph), flat.graph)


@given(seed=st.integers(0, 2**31), most=st.integers(1, 30))
@settings(max_examples=40)
def test_where_no_skill_can_run_out_no_node_has_a_copy(seed: int, most: int) -> None:
    skill = nested(seed, (30, 30, 30))
    kinds = [
        s.actions.actions[i] for s in skill.levels for i in s.graph.action[0].tolist() if i >= 0
    ]
    primitives = sum(not isinstance(kind, SubSkill) for kind in kinds)
    assert 1 <= flattened(skill, most).num_nodes <= primitives


def test_a_skill_without_sub_skills_stays_up_to_its_own_limit() -> None:
    skill = random_skill(3, "one", paper_actions(), 7)
    flat = flattened(skill, 7)
    assert flat.actions.names == skill.actions.names
    assert same_behaviour(flat, skill)
    assert flat.num_nodes == int(merged(skill.graph).num_nodes)


def looking(limit: int, actions: ActionSet) -> Skill:
    """Looks for ever."""
    return Skill("looking", chain(actions, "Detect"), actions, limit)


def test_a_count_is_kept_by_copies_and_what_has_run_out_idles() -> None:
    skill = looking(5, paper_actions())
    assert flattened(skill, 5).num_nodes == 1
    flat = flattened(skill, 6)
    assert [flat.actions.names[i] for i in flat.graph.action[0].tolist()] == (
        ["Detect"] * 5 + ["BranchingNN"]
    )
    with pytest.raises(GraphError, match="no BranchingNN among Detect, Grasp for a flat skill"):
        flattened(looking(5, ActionSet(("Detect", "Grasp"), (Detect(), Grasp()))), 6)


@pytest.mark.parametrize(("outer", "inner"), [(1, 1), (1, 4), (4, 1), (3, 5)])
def test_counts_of_two_levels_are_kept_to_the_last_action(outer: int, inner: int) -> None:
    base = paper_actions()
    actions = base.extended(["looking"], [SubSkill(looking(inner, base))])
    skill = Skill("top", chain(actions, "looking"), actions, outer)
    both = outer * inner
    assert flattened(skill, both).num_nodes == 1
    flat = flattened(skill, both + 1)
    assert flat.num_nodes == both + 1
    place = world(0, 3)
    once = rollout(skill.graph, skill.actions, place, max_transitions=outer)
    again = rollout(flat.graph, flat.actions, place, max_transitions=both + 1)
    assert torch.equal(once.percept, again.percept)
    assert once.transitions.eq(both).all()


def test_too_many_nodes_are_refused() -> None:
    with pytest.raises(GraphError, match="'looking' would have more than 10000 nodes; give fewer"):
        flattened(looking(10_001, paper_actions()), 10_002)
    assert flattened(looking(200, paper_actions()), 201).num_nodes == 201


def test_an_end_without_success_within_a_sub_skill_is_refused() -> None:
    skills = (random_skill(seed, "top", nested_actions(seed)) for seed in range(20))
    skill = next(s for s in skills if "Counter" in s.sub_skills["S0"].node_actions)
    with pytest.raises(GraphError, match="Counter ends sub-skill 'S0' with outcome 'lost'"):
        flattened(skill, 20)


def test_an_action_that_is_another_one_within_is_refused() -> None:
    inner = random_skill(0, "S0", endless_actions())
    names, modules = endless_actions().names, (*inner.actions.actions[:-1], Visits())
    actions = ActionSet(names, modules).extended(["S0"], [SubSkill(inner)])
    with pytest.raises(GraphError, match="has another action 'Visits'"):
        flattened(random_skill(1, "top", actions), 20)
