"""What members solve, remembered: nothing is tried twice, and only what is known is counted on."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import world_of
from support import seeded
from watched import (
    Watched,
    along,
    first_stage,
    keys,
    recruited,
    stage_of,
    state_of,
    without_models,
)

from cgtorch.improvement import team
from cgtorch.improvement.compose import branches_of, branching_action, compose
from cgtorch.improvement.improve import improve
from cgtorch.improvement.outcomes import (
    NEIGHBOURS,
    begun,
    decisive,
    estimated_rates,
    expected,
    known_rates,
    near_by,
    surely,
    tried,
)
from cgtorch.improvement.setup import Progress
from cgtorch.improvement.state import Candidate, StageState
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios, stage_scenarios

ACTIONS = paper_actions()
BRANCH = branching_action(ACTIONS)[1]
MEMBERS = tuple(replace(nearly(ahead), name=f"m{i}") for i, ahead in enumerate((0.25, 0.4, 0.55)))


def random_state(seed: int, count: int = 15) -> StageState[Any]:
    generator = seeded(seed)
    scenarios = random_scenarios("perimeter", count, generator)
    state = state_of(scenarios, MEMBERS)
    return replace(state, outcomes=torch.randint(-1, 2, (count, 3), generator=generator))


def candidate_of(seed: int) -> Candidate:
    branches = torch.randn(2, BRANCH.num_parameters, generator=seeded(seed))
    skill = compose("both", list(MEMBERS), branches, ACTIONS, 20, corrected=False)
    return Candidate(skill, (0, 1, 2), branches)


@given(st.integers(0, 2**20))
def test_a_candidate_is_known_where_the_member_is_to_whom_it_sends(seed: int) -> None:
    state, new = random_state(seed), candidate_of(seed)
    sent = new.sent_to(state.percepts).tolist()
    wanted = [int(state.outcomes[row, place]) for row, place in enumerate(sent)]
    assert surely(state, new).tolist() == wanted
    old = candidate_of(seed + 1)
    keep = torch.rand(15, generator=seeded(seed)) < 0.5
    state = replace(state, current=old, keep=keep, shown=-torch.ones(15).long() * ~keep)
    rates = known_rates(state)
    assert torch.equal(rates[:, :3], (state.outcomes > 0).float())
    now = keep | (surely(state, old) > 0)
    assert torch.equal(rates[:, 3] > 0, now)
    then = [now[row] if known == 0 else known > 0 for row, known in enumerate(wanted)]
    assert torch.equal(expected(state, new), torch.stack([now, torch.tensor(then)], 1).float())
    assert not surely(state, Candidate(MEMBERS[0])).any()


@given(st.integers(0, 2**20), st.integers(3, 20))
def test_a_member_is_trusted_where_it_solves_the_neighbours(seed: int, count: int) -> None:
    state = random_state(seed, count)
    found = estimated_rates(state, 0.9)
    for row in range(count):
        distance = (state.percepts - state.percepts[row]).norm(dim=1)
        near = distance.argsort()[:NEIGHBOURS]
        for place in range(3):
            own, around = int(state.outcomes[row, place]), state.outcomes[near, place].tolist()
            wanted = 0.9 if 1 in around and -1 not in around else 0.0
            wanted = wanted if own == 0 else float(own > 0)
            assert float(found[row, place]) == torch.tensor(wanted)


def test_scenarios_that_decide_and_those_near_by() -> None:
    state = random_state(0, 4)
    outcomes = torch.tensor([[1, 0, -1], [1, 1, 0], [-1, 0, -1], [0, 0, 0]])
    assert decisive(replace(state, outcomes=outcomes)).tolist() == [True, False, False, False]
    percepts = torch.zeros(4, 7)
    percepts[:, 0] = torch.tensor([0.0, 1.0, 5.0, 7.0])
    state = replace(state, percepts=percepts)
    rows, among = torch.tensor([0, 3]), torch.tensor([1, 2])
    assert near_by(state, rows, among, 2).tolist() == [1, 2]
    assert near_by(state, rows[1:], among, 1).tolist() == [2]
    assert near_by(state, rows, among, 0).tolist() == []


def test_members_meet_one_scenario_before_they_meet_many() -> None:
    scenarios = random_scenarios("perimeter", 40, seeded(5))
    results = [try_skill(m, world_of(scenarios)).succeeded for m in MEMBERS]
    watched = Watched()
    setup = stage_of(replace(without_models(remembers=True), world_of=watched))
    state = tried(setup, state_of(scenarios, MEMBERS), range(3))
    sizes = [len(each.keys) for each in watched.trials]
    for place, result in enumerate(results):
        rows = (state.outcomes[:, place] != 0).nonzero()[:, 0]
        assert torch.equal(state.outcomes[rows, place] > 0, result[rows])
    assert sizes[0] == 1
    assert sum(sizes) == int((state.outcomes != 0).sum())
    solved = state.outcomes > 0
    assert solved.any()
    assert (solved.sum(1) <= 1).all()  # nobody meets what somebody solves
    again = tried(setup, state, [0])
    fresh = (again.outcomes != 0) & (state.outcomes == 0)
    assert not fresh[solved.any(1)].any()


def test_whoever_solves_all_meets_twice_as_many_each_time() -> None:
    scenarios = random_scenarios("near", 60, seeded(5))
    able = scenarios[try_skill(MEMBERS[0], world_of(scenarios)).succeeded][:12]
    watched = Watched()
    setup = stage_of(replace(without_models(remembers=True), world_of=watched))
    assert tried(setup, state_of(able, MEMBERS), [0]).outcomes[:, 0].tolist() == [1] * 12
    assert [len(each.keys) for each in watched.trials] == [1, 2, 4, 5]


def test_whoever_has_failed_is_not_tried_again_when_a_member_joins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    idle = [replace(nearly(-1.0 - i), name=f"idle {i}") for i in range(3)]
    recruited(monkeypatch, idle[2])
    scenarios = random_scenarios("perimeter", 5, seeded(0))
    state = state_of(scenarios, (idle[0], idle[1]))
    _, after = team.proposed(stage_of(without_models(remembers=True)), state)
    assert after.outcomes[0].tolist() == [-1] * 3
    assert not after.outcomes[1:].any()


def test_a_stage_begins_with_what_its_skill_has_shown() -> None:
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    percepts = first_percepts(world_of(scenarios))
    every = map(candidate_of, range(100))
    candidate = next(each for each in every if len(each.sent_to(percepts).unique()) > 1)
    succeeded = try_skill(candidate.skill, world_of(scenarios)).succeeded
    state = state_of(scenarios, MEMBERS, keep=succeeded, current=Candidate(candidate.skill))
    state = replace(state, shown=2 * succeeded.long() - 1)
    found = begun(state)
    assert found.current is not None
    sent = candidate.sent_to(state.percepts)
    assert torch.equal(found.current.sent_to(state.percepts), sent)
    for row in range(60):
        wanted = torch.zeros(3).long()
        wanted[sent[row]] = state.shown[row]
        assert torch.equal(found.outcomes[row], wanted)
    alone = replace(state_of(scenarios, MEMBERS[:1], keep=succeeded), current=Candidate(MEMBERS[0]))
    assert torch.equal(begun(alone).outcomes[:, 0] > 0, succeeded)
    assert begun(replace(alone, current=None)).current is None


def test_a_composed_skill_tells_its_members_and_branches() -> None:
    candidate = candidate_of(1)
    found = branches_of(candidate.skill)
    assert found is not None
    names, branches = found
    assert names == ["m0", "m1", "m2"]
    assert candidate.branches is not None
    assert torch.equal(branches, candidate.branches)
    assert branches_of(MEMBERS[0]) is None


def test_who_fails_alone_fails_in_a_team_that_is_not_corrected() -> None:
    scenarios = random_scenarios("perimeter", 60, seeded(6))
    candidate = candidate_of(2)
    sent = candidate.sent_to(first_percepts(world_of(scenarios)))
    alone = torch.stack([try_skill(m, world_of(scenarios)).succeeded for m in MEMBERS], 1)
    team = try_skill(candidate.skill, world_of(scenarios)).succeeded
    own = alone.gather(1, sent[:, None])[:, 0]
    assert team[own].all()
    corrected = compose("both", list(MEMBERS), candidate.branches, ACTIONS, 20)  # type: ignore[arg-type]
    assert try_skill(corrected, world_of(scenarios)).succeeded[own].all()


@pytest.mark.hostile
def test_a_stage_that_remembers_keeps_w_and_asks_for_less() -> None:
    """The same search, and W of an earlier stage; only what may have changed is tried again."""
    base = stage_scenarios("near")
    first = improve(
        stage_of(without_models(remembers=True, practice=10, replicas=1), name="S0"),
        first_stage(), base, along("near"),
    )  # fmt: skip
    assert first.skill is not None
    counts = []
    for remembers in (False, True):
        watched = Watched()
        setup = replace(
            without_models(remembers=remembers, practice=10, replicas=1), world_of=watched
        )
        after: Progress[Any] = improve(
            stage_of(setup), first, stage_scenarios("left"), along("left")
        )
        assert after.skill is not None
        assert try_skill(after.skill, world_of(after.solved)).succeeded.all()
        assert len(after.solved) > len(first.solved)
        known = set(keys(first.solved))
        counts.append(sum(key in known for key in watched.acted))
    assert counts[0] >= len(first.solved)
    assert counts[1] < counts[0] / 2


@pytest.mark.hostile
def test_what_earlier_stages_missed_is_handed_on_but_not_tried() -> None:
    scenarios, far = stage_scenarios("near"), stage_scenarios("far")
    skill = MEMBERS[0]
    trial = try_skill(skill, world_of(scenarios.joined(far)))
    good = trial.succeeded
    every = scenarios.joined(far)
    before = first_stage(
        skill, solved=every[good], missed=every[~good],
        seen=torch.cat([trial.percepts[good], trial.percepts[~good]]),
    )  # fmt: skip
    assert len(before.missed)
    watched = Watched()
    how = {"remembers": True, "practice": 6, "replicas": 1, "world_of": watched}
    none = stage_scenarios("near", 0)
    after = improve(stage_of(without_models(**how)), before, none, along("near"))
    assert not set(keys(before.missed)) & set(watched.acted)
    assert set(keys(before.missed)) <= set(keys(after.missed))
    assert after.seen is not None
    every = after.solved.joined(after.missed)
    assert torch.equal(after.seen, first_percepts(world_of(every)))
