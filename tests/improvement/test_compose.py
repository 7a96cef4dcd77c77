"""Composed skills: branches over frozen members, run by the engine."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import networkx as nx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, random_skill, seeded, world
from told_by_runs import tensors_of

from cgtorch.graphs import ActionSet, Skill, from_networkx, load_skill, same_behaviour, save_skill
from cgtorch.graphs.view import View
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import ActionError
from cgtorch.improvement.compose import (
    branches_of,
    branching_action,
    broad_group,
    compose,
    fewest_members,
    local_group,
    specialists_of,
)
from cgtorch.improvement.gating import selected_members, train_gating
from cgtorch.improvement.setup import Grouping
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import Detect, Grasp, MoveBase, paper_actions

ACTIONS = paper_actions()
BRANCH = branching_action(ACTIONS)[1]
COUNT = 60


def members(count: int) -> list[Skill]:
    return [random_skill(s, f"member {s}", ACTIONS, max_transitions=8) for s in range(count)]


def branches(count: int, seed: int) -> torch.Tensor:
    """Branches that send the scenarios of `world` to different members, by where objects are."""
    percepts = world(0, COUNT).start(torch.arange(COUNT))[1]
    edges = percepts[:, 5].quantile(torch.linspace(0, 1, count + 1)[1:-1])
    zone = torch.bucketize(percepts[:, 5].contiguous(), edges)
    solves = torch.nn.functional.one_hot(zone, count).float()
    found = train_gating(BRANCH, percepts, solves, torch.ones(COUNT), seeded(seed))
    assert len(set(selected_members(BRANCH, found, percepts).tolist())) == count
    return found


@pytest.mark.parametrize("count", [2, 3, 5])
def test_each_scenario_is_run_by_the_member_it_is_sent_to(count: int) -> None:
    """Step by step what the member does alone, since noise belongs to the scenario."""
    team, parameters = members(count), branches(count, count)
    skill = compose("all", team, parameters, ACTIONS, max_transitions=count + 1)
    assert skill.num_nodes == 2 * count - 1
    assert skill.depth == 2
    assert not skill.graph.parameters[0, count - 1 :].any()  # members are frozen
    assert compose("all", team, parameters, ACTIONS, 1).max_transitions == count + 1
    place = world(0, COUNT)
    member = selected_members(BRANCH, parameters, place.start(torch.arange(COUNT))[1])
    alone = [rollout(s.graph, s.actions, place, max_transitions=s.max_transitions) for s in team]
    whole = rollout(skill.graph, skill.actions, place, max_transitions=skill.max_transitions)
    compared = 0
    for i, m in enumerate(member.tolist()):
        asked = min(m, count - 2) + 1  # how many branches it took to get there
        if alone[m].succeeded[0, i]:
            compared += 1
            assert whole.succeeded[0, i]
            assert torch.equal(whole.percept[0, i], alone[m].percept[0, i])
            assert int(whole.transitions[0, i]) == asked + int(alone[m].transitions[0, i])
    assert compared >= 3


def visited(skill: Skill, count: int = COUNT) -> list[list[int]]:
    """The rows of the node table that each scenario visits, first those of the skill's own."""
    found: list[list[int]] = [[] for _ in range(count)]

    def trace(active: torch.Tensor, node: torch.Tensor, outcome: torch.Tensor, _: Lanes) -> None:
        for lane, slot in zip(active.tolist(), node.tolist(), strict=True):
            found[lane].append(slot)

    limit = skill.max_transitions
    rollout(skill.graph, skill.actions, world(0, count), max_transitions=limit, trace=trace)
    return found


def test_a_member_that_fails_hands_over_to_the_next() -> None:
    """Members only look, until they have run out of their transitions."""
    view: View = nx.MultiDiGraph(start=0)
    view.add_node(0, action="Detect", parameters=[])
    view.add_edge(0, 0, outcome="success")
    limits, looker = [3, 2, 4], from_networkx(view, ACTIONS)
    team = [Skill(f"member {n}", looker, ACTIONS, n) for n in limits]
    parameters = branches(3, 3)
    skill = compose("all", team, parameters, ACTIONS, max_transitions=6)
    seen = world(0, COUNT).start(torch.arange(COUNT))[1]
    member = selected_members(BRANCH, parameters, seen).tolist()
    assert set(member) == {0, 1, 2}
    for way, m in zip(visited(skill), member, strict=True):
        asked = list(range(min(m, 1) + 1))
        # A member's only node stands behind the five of the whole; four members have their turn.
        turns = [(m + i) % 3 for i in range(6 - len(asked))]
        assert way == asked + [5 + turn for turn in turns for _ in range(limits[turn])]


def test_composed_skills_can_be_stored_and_composed_again(tmp_path: Path) -> None:
    inner = compose("S0", members(2), branches(2, 2), ACTIONS, 20)
    outer = compose("S1", [random_skill(9, "new", ACTIONS), inner], branches(2, 3), ACTIONS, 20)
    assert outer.depth == 3
    save_skill(tmp_path / "skill.json", outer)
    again = load_skill(tmp_path / "skill.json", ACTIONS)
    one, two = (rollout(s.graph, s.actions, world(0, 30)) for s in (outer, again))
    for name, value in tensors_of(one).items():
        assert torch.equal(value, getattr(two, name))


def test_members_of_one_name_are_an_error() -> None:
    one, two = members(2)
    with pytest.raises(ActionError, match="is used twice"):
        compose("all", [one, replace(two, name=one.name)], branches(2, 1), ACTIONS, 20)


def test_members_that_behave_the_same_are_one_node() -> None:
    """Unless a member fails, the whole does what it does with a node for each."""
    one, two = members(2)
    again = replace(one, name="again")
    parameters = branches(3, 3)
    small = compose("all", [one, two, again], parameters, ACTIONS, 20)
    assert small.num_nodes == 4
    assert set(small.sub_skills) == {one.name, two.name}
    longer = replace(again, max_transitions=again.max_transitions + 1)
    assert compose("all", [one, two, longer], parameters, ACTIONS, 20).num_nodes == 5
    # The last member is a copy of the first one, but of other modules, which are never compared.
    twin = replace(again, actions=paper_actions())
    large = compose("all", [one, two, twin], parameters, ACTIONS, 20)
    assert large.num_nodes == 5
    once, all_three = (rollout(s.graph, s.actions, world(0, COUNT)) for s in (small, large))
    place = world(0, COUNT)
    sent = selected_members(BRANCH, parameters, place.start(torch.arange(COUNT))[1])
    alone = torch.stack([rollout(s.graph, s.actions, place).succeeded[0] for s in (one, two, one)])
    at_once = alone.gather(0, sent[None])[0]
    assert at_once.any()
    for name, value in tensors_of(once).items():
        assert torch.equal(value[:, at_once], getattr(all_three, name)[:, at_once]), name


def test_a_team_that_behaves_the_same_is_that_member_under_a_new_name() -> None:
    (one,) = members(1)
    for team, parameters in (
        ([one], torch.zeros(0, BRANCH.num_parameters)),
        ([one, replace(one, name="again")], branches(2, 1)),
    ):
        skill = compose("all", team, parameters, ACTIONS, 20)
        assert (skill.name, skill.depth) == ("all", 1)
        assert same_behaviour(skill, replace(one, max_transitions=20))


def test_composing_needs_a_branching_network() -> None:
    few = ActionSet(("MoveBase", "Detect", "Grasp"), (MoveBase(), Detect(), Grasp()))
    with pytest.raises(ActionError, match="no BranchingNN among MoveBase, Detect, Grasp"):
        branching_action(few)


@given(st.integers(0, 2**31), st.integers(1, 12), st.integers(0, 6), st.integers(0, 6))
def test_few_members_solve_all_that_any_solve(seed: int, rows: int, count: int, most: int) -> None:
    solves = torch.rand(rows, count, generator=seeded(seed)) < 0.4
    every, few = fewest_members(solves, count), fewest_members(solves, most)
    assert every == sorted(set(every))
    assert len(few) == min(len(every), most)
    assert set(few) <= set(every)
    covered = solves.any(1)
    assert torch.equal(solves[:, every].any(1), covered)
    if most and count:
        assert int(solves[:, few].any(1).sum()) >= int(solves.sum(0).max())
    fewest = next(
        size
        for size in range(count + 1)
        for some in combinations(range(count), size)
        if torch.equal(solves[:, list(some)].any(1), covered)
    )
    # Greedy choice of n scenarios takes at most H(n) times the fewest (Johnson 1974).
    harmonic = sum(1 / i for i in range(1, rows + 1))
    assert fewest <= len(every) <= harmonic * max(1, fewest)


def test_the_members_of_a_composed_skill_are_named_once_each_in_the_order_of_its_branches() -> None:
    actions, team, parameters = custom_actions(), members(3), torch.rand(2, BRANCH.num_parameters)
    assert actions.outcome_capacity > 2
    found = branches_of(compose("all", team, parameters, actions, 20))
    assert found is not None
    assert found[0] == [each.name for each in team]
    assert torch.equal(found[1], parameters)


def test_specialists_are_the_innermost_skills() -> None:
    a, b, c = members(3)
    first = compose("S0", [a, b], branches(2, 0), ACTIONS, 20)
    second = compose("S1", [c, first], branches(2, 1), ACTIONS, 20)
    assert specialists_of(a) == ()
    assert {s.name: s for s in specialists_of(first)} == {a.name: a, b.name: b}
    assert {s.name: s for s in specialists_of(second)} == {m.name: m for m in (a, b, c)}


@given(
    st.lists(st.booleans(), min_size=1, max_size=12).filter(any),
    st.integers(1, 15),
    st.integers(0, 2**31),
)
def test_local_groups(missed: list[bool], size: int, seed: int) -> None:
    percepts = torch.randn(len(missed), 7, generator=seeded(seed))
    group = local_group(percepts, torch.tensor(missed), size, seeded(seed)).tolist()
    rows = [i for i, m in enumerate(missed) if m]
    assert set(group) <= set(rows)
    assert len(group) == len(set(group)) == min(size, len(rows))
    # Its first is the one it was made around: nobody outside is nearer than anybody within.
    distance = (percepts - percepts[group[0]]).norm(dim=1).tolist()
    outside = [distance[i] for i in rows if i not in group]
    assert max(distance[i] for i in group) <= min(outside, default=float("inf")) + 1e-4


def test_any_missed_scenario_may_be_the_middle_of_a_group() -> None:
    percepts, missed = torch.eye(6, 7), torch.tensor([True, False, True, True, False, True])
    found = {int(local_group(percepts, missed, 1, seeded(s))[0]) for s in range(60)}
    assert found == {0, 2, 3, 5}


@given(st.integers(1, 30), st.integers(1, 12), st.integers(0, 2**31))
def test_a_group_of_any_place_is_a_random_part_of_what_is_missed(
    count: int, size: int, seed: int
) -> None:
    missed = torch.rand(count, generator=seeded(seed)) < 0.5
    group = broad_group(torch.zeros(count, 7), missed, size, seeded(seed)).tolist()
    assert len(set(group)) == len(group) == min(size, int(missed.sum()))
    assert missed[group].all()


def test_every_missed_scenario_may_be_of_the_group() -> None:
    missed = torch.arange(6) % 2 == 0
    groups = [broad_group(torch.zeros(6, 1), missed, 1, seeded(i)).tolist() for i in range(30)]
    assert {row for group in groups for row in group} == {0, 2, 4}


@pytest.mark.parametrize("group_of", [broad_group, local_group])
def test_a_group_follows_from_its_generator(group_of: Grouping) -> None:
    percepts, missed = torch.randn(50, 2, generator=seeded(0)), torch.ones(50, dtype=torch.bool)
    first, again = (group_of(percepts, missed, 9, seeded(1)) for _ in range(2))
    assert torch.equal(first, again)


def test_of_scenarios_that_are_equally_near_the_first_ones_are_of_the_group() -> None:
    percepts, missed = torch.arange(200)[:, None] % 2.0, torch.ones(200, dtype=torch.bool)
    group = local_group(percepts, missed, 130, seeded(0))
    same = percepts[group, 0] == percepts[group[0], 0]
    assert same.tolist() == [True] * 100 + [False] * 30
    for part in (group[:100], group[100:]):
        assert part.tolist() == sorted(part.tolist())
