"""A flattened skill: one graph of primitive actions, and what cannot be flattened."""

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
    world,
)

from cgtorch.actions import ActionSet, paper_actions
from cgtorch.errors import GraphError
from cgtorch.graphs import Skill, SubSkill, flattened, merged
from cgtorch.simulation import Rollouts, rollout

FAR = 1000
"""More transitions than any run makes here, so that no skill runs out of them."""


def nested(seed: int, limits: tuple[int, int] = (FAR, FAR), top: int = FAR) -> Skill:
    """A random skill on three levels; only what ends the whole may end it without success."""
    actions = nested_actions(seed, endless_actions(), limits)
    actions = actions.extended(["Counter"], [custom_actions().actions[-1]])
    actions = as_double_actions(actions)
    skill = random_skill(seed + 2, "top", actions, top)
    return replace(skill, graph=as_double(skill.graph))


def run(skill: Skill, seed: int, place: str) -> Rollouts:
    environment = {"world": world, "model": model}[place](seed, 8, dtype=torch.float64)
    limit = skill.max_transitions
    return rollout(skill.graph, skill.actions, environment, max_transitions=limit, max_steps=40)


@given(seed=st.integers(0, 2**31), place=st.sampled_from(["world", "model"]))
@settings(max_examples=40)
def test_where_no_skill_runs_out_all_runs_are_the_same(seed: int, place: str) -> None:
    skill = nested(seed)
    flat = flattened(skill)
    once = run(skill, seed, place)
    for other in (flat, replace(flat, graph=merged(flat.graph))):
        for name, value in vars(run(other, seed, place)).items():
            assert torch.equal(value, getattr(once, name)), name


@given(st.integers(0, 2**31))
@settings(max_examples=40)
def test_a_flat_skill_is_one_valid_graph_of_the_nodes_of_all_levels(seed: int) -> None:
    skill = nested(seed)
    flat = flattened(skill)
    assert is_valid(flat.graph, flat.actions)
    assert flat.name == skill.name
    assert flat.depth == 1
    assert flat.sub_skills == {}
    assert not any(isinstance(a, SubSkill) for a in flat.actions.actions)
    levels = skill, *skill.sub_skills.values(), skill.sub_skills["S1"].sub_skills["S0"]
    distinct = {id(s): s for s in levels}.values()
    assert (
        1
        <= flat.num_nodes
        <= sum(
            sum(
                not isinstance(s.actions.actions[a], SubSkill)
                for a in s.graph.action[0].tolist()
                if a >= 0
            )
            for s in distinct
        )
    )


def test_a_skill_without_sub_skills_stays() -> None:
    skill = random_skill(3, "one", paper_actions(), 7)
    flat = flattened(skill)
    assert flat.max_transitions == 7
    assert flat.actions.names == skill.actions.names
    for name, value in vars(skill.graph).items():
        assert torch.equal(getattr(flat.graph, name), value), name


def test_a_flat_skill_may_go_through_all_levels() -> None:
    """The last transition of each level enters the next: 6, 4 and 3 actions."""
    assert flattened(nested(0, (3, 5), 7)).max_transitions == 6 + 4 + 3


def test_an_end_without_success_within_a_sub_skill_is_refused() -> None:
    for seed in range(20):
        skill = random_skill(seed, "top", nested_actions(seed))
        if "Counter" in used(skill.sub_skills["S0"]):
            with pytest.raises(GraphError, match="Counter ends sub-skill 'S0' with outcome 'lost'"):
                flattened(skill)
            return
    pytest.fail("no sub-skill with a Counter")


def used(skill: Skill) -> set[str]:
    return {skill.actions.names[i] for i in skill.graph.action[0].tolist() if i >= 0}


def test_an_action_that_is_another_one_within_is_refused() -> None:
    inner = random_skill(0, "S0", endless_actions())
    names, modules = endless_actions().names, (*inner.actions.actions[:-1], Visits())
    actions = ActionSet(names, modules).extended(["S0"], [SubSkill(inner)])
    with pytest.raises(GraphError, match="has another action 'Visits'"):
        flattened(random_skill(1, "top", actions))
