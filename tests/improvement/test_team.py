"""The team of a stage: who is evolved, on what, who is chosen, and who is blamed for a failure."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import world_of
from support import seeded
from watched import recruited, stage_of, state_of, without_models

from cgtorch.graphs import BranchingNN
from cgtorch.improvement import team
from cgtorch.improvement.compose import branches_of, branching_action, compose
from cgtorch.improvement.setup import Setup
from cgtorch.improvement.state import BLAME, FEWEST, STEPS, Candidate
from cgtorch.improvement.team import RELIABLE, composed, extended, shares
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios

ACTIONS = paper_actions()
FEW = Setup.team
BRANCH = branching_action(ACTIONS)[1]


def test_the_fewest_members_that_solve_everything_are_chosen() -> None:
    """What is left is flat and small, and solves all that any of them does."""
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    near, twin, far, useless = (
        replace(nearly(ahead), name=name)
        for ahead, name in ((0.25, "near"), (0.25, "twin"), (0.55, "far"), (-1.0, "useless"))
    )
    members = (useless, near, twin, far)
    state = state_of(scenarios, members)
    results = [try_skill(m, world_of(scenarios)).succeeded for m in members]
    assert not results[0].any()
    assert (results[3] & ~results[1]).any()
    rates = torch.stack(results, 1).float()
    found = composed(stage_of(without_models()), replace(state, number=3), rates)
    assert found.chosen == (1, 3)
    assert found.skill.name == "S1-3"
    assert set(found.skill.sub_skills) == {"near", "far"}
    assert (found.skill.num_nodes, found.skill.depth) == (3, 2)
    solved = try_skill(found.skill, world_of(scenarios)).succeeded
    assert (solved | ~(results[1] | results[3])).all()


def test_an_earlier_skill_stays_where_others_would_lose_something() -> None:
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    earlier, far = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")
    results = [try_skill(m, world_of(scenarios)).succeeded for m in (earlier, far)]
    state = state_of(scenarios, (earlier, far), results[0])
    found = composed(stage_of(without_models()), state, torch.stack(results, 1).float())
    assert "S0" in found.skill.sub_skills
    assert try_skill(found.skill, world_of(scenarios)).succeeded[results[0]].all()


@given(st.integers(0, 2**20), st.integers(1, 12))
def test_a_team_has_a_few_members_who_are_reliable(seed: int, count: int) -> None:
    """If nobody is, it has the best one, so that somebody acts."""
    generator = seeded(seed)
    scenarios = random_scenarios("near", 7, generator)
    members = tuple(replace(nearly(0.1 + i / 20), name=f"m{i}") for i in range(count))
    state = state_of(scenarios, members)
    rates = torch.rand(7, count, generator=generator)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(team, "train_gating", lambda branch, percepts, solves, *_: (
            torch.zeros(solves.shape[1] - 1, branch.num_parameters)
        ))  # fmt: skip
        found = composed(stage_of(without_models()), state, rates)
    able = rates >= RELIABLE
    assert 1 <= len(found.chosen) <= FEW
    if able.any():
        assert able[:, list(found.chosen)].any(0).all()
        if count <= FEW:
            assert torch.equal(able[:, list(found.chosen)].any(1), able.any(1))
    else:
        assert found.chosen == (int(rates.mean(0).argmax()),)


@given(st.integers(0, 2**20), st.integers(1, 5), st.integers(1, 12))
def test_who_was_sent_there_is_blamed(seed: int, count: int, rows: int) -> None:
    """Its share there becomes less, and nobody else's, nor its own elsewhere."""
    generator = seeded(seed)
    members = tuple(replace(nearly(0.1 + i / 20), name=f"m{i}") for i in range(count + 2))
    chosen = tuple(torch.randperm(count + 2, generator=generator)[:count].sort()[0].tolist())
    branches = torch.randn(count - 1, BRANCH.num_parameters, generator=generator)
    scenarios = random_scenarios("perimeter", 15, generator)
    state = state_of(scenarios, members)
    state = replace(state, trust=torch.rand(15, count + 2, generator=generator), actions=(5,))
    candidate = Candidate(nearly(0.3), chosen, branches)
    tried = torch.randperm(15, generator=generator)[:rows]
    succeeded = torch.rand(rows, generator=generator) < 0.5
    actions = torch.randint(1, 20, (rows,), generator=generator)
    result = tried, succeeded, actions[succeeded]
    after = state.after(candidate, *result)
    trust = state.trust.clone()
    for row, good in zip(tried.tolist(), succeeded.tolist(), strict=True):
        sent = int(candidate.sent_to(state.percepts[row : row + 1]))
        assert sent in chosen
        assert bool(after.keep[row]) is good
        assert after.tried[row]
        assert int(after.shown[row]) == (1 if good else -1)
        assert int(after.outcomes[row, sent]) == (1 if good else -1)
        if not good:
            trust[row, sent] = trust[row, sent] * BLAME
    assert torch.equal(after.trust, trust)
    others = torch.ones(15, dtype=torch.bool).index_fill(0, tried, False)
    assert torch.equal(after.keep[others], state.keep[others])
    assert torch.equal(after.tried[others], state.tried[others])
    assert not after.shown[others].any()
    assert after.acting(candidate).current is candidate
    assert not after.acting(candidate).shown.any()  # others did that
    same = replace(after, current=candidate).acting(candidate)
    assert torch.equal(same.shown, after.shown)
    assert after.actions == (5, *actions[succeeded].tolist())
    assert int((after.outcomes != 0).sum()) == rows
    unknown = state.after(Candidate(nearly(0.3)), *result)
    assert torch.equal(unknown.trust, state.trust)
    assert not unknown.outcomes.any()


def test_shares_are_those_of_replays() -> None:
    """Under other noise each, and the same for all skills."""
    scenarios = random_scenarios("near", 60, seeded(1))
    state = state_of(scenarios, ())
    skills = [nearly(0.3), nearly(0.6), nearly(0.3)]
    setup = without_models(replays=5)
    found = shares(stage_of(setup), state, skills)
    for column, skill in enumerate(skills):
        runs = [try_skill(skill, world_of(scenarios.with_noise(i))).succeeded for i in range(5)]
        assert torch.allclose(found[:, column], torch.stack(runs).float().mean(0))
    assert len(found[:, :2].unique()) > 2
    assert shares(stage_of(setup), state, []).shape == (60, 0)


@pytest.mark.parametrize("repeats", [False, True])
@pytest.mark.parametrize("successes", [(2,) * (FEWEST - 1), (2,) * FEWEST, (20,) * FEWEST])
def test_replays_are_broken_off_where_a_trial_would_be(
    successes: tuple[int, ...], repeats: bool
) -> None:
    """With as few world actions as successes have taken, somebody slow does not come near."""
    scenarios, slow = random_scenarios("near", 30, seeded(1)), nearly(0.02)
    slow = replace(slow, max_transitions=90)
    state = replace(state_of(scenarios, (), actions=successes), repeats=repeats)
    trial = try_skill(slow, world_of(scenarios))
    unlimited = repeats or len(successes) < FEWEST or successes[0] == 20
    limit = 90 if unlimited else STEPS * state.most
    wanted = trial.succeeded & (trial.transitions <= limit)
    found = shares(stage_of(without_models(replays=1)), state, [slow])[:, 0]
    assert torch.equal(found > 0.5, wanted)
    assert torch.equal(wanted, trial.succeeded) is unlimited
    assert trial.succeeded.sum() > 5


def test_replays_have_a_limit_once_enough_successes_are_known() -> None:
    state = state_of(random_scenarios("near", 1, seeded(0)))
    for count, limit in ((FEWEST - 1, None), (FEWEST, STEPS * 20), (FEWEST + 1, STEPS * 20)):
        assert replace(state, actions=(10,) * count).most_steps == limit


def test_state_grows_with_what_is_met() -> None:
    scenarios = random_scenarios("near", 3, seeded(0))
    state = state_of(scenarios, (nearly(0.1), nearly(0.2)))
    ones = torch.ones(3, 2, dtype=torch.long)
    state = replace(state, trust=torch.zeros(3, 2), outcomes=ones, shown=ones[:, 0])
    more = random_scenarios("near", 2, seeded(1))
    percepts = first_percepts(world_of(more))
    for kept in (False, True):
        for targets in (False, True):
            after = state.extended(more, percepts, kept=kept, targets=targets)
            assert torch.equal(after.scenarios.seed, torch.cat([scenarios.seed, more.seed]))
            assert torch.equal(after.percepts[3:], percepts)
            assert after.keep[3:].tolist() == after.tried[3:].tolist() == [kept] * 2
            assert after.targets[3:].tolist() == [targets] * 2
            assert after.known[3:].tolist() == [kept] * 2
            assert after.shown.tolist() == [1] * 3 + [0] * 2
            assert after.outcomes.tolist() == [[1, 1]] * 3 + [[0, 0]] * 2
            assert torch.equal(after.trust, torch.tensor([[0.0, 0.0]] * 3 + [[1.0, 1.0]] * 2))


def test_a_new_member_is_trusted_everywhere_and_nothing_is_known_of_it() -> None:
    members = nearly(0.1), nearly(0.2)
    ones = torch.ones(3, 1, dtype=torch.long)
    state = state_of(random_scenarios("near", 3, seeded(0)), members[:1])
    after = replace(state, trust=torch.zeros(3, 1), outcomes=ones).joined_by(members[1])
    assert after.members == members
    assert after.trust.tolist() == [[0.0, 1.0]] * 3
    assert after.outcomes.tolist() == [[1, 0]] * 3


@pytest.mark.parametrize("seed", range(3))
def test_an_extended_skill_goes_its_own_ways_where_no_new_member_is_sent_to(seed: int) -> None:
    """It solves what it has solved, though its own members are known to solve nothing else."""
    generator = seeded(seed)
    scenarios = random_scenarios("perimeter", 40, generator)
    members = tuple(replace(nearly(i / 10), name=f"m{i}") for i in range(4))
    branches = torch.randn(1, BRANCH.num_parameters, generator=generator)
    skill = compose("S0", [members[2], members[0]], branches, ACTIONS, 20, corrected=False)
    current = Candidate(skill, (2, 0), branches)
    seen = first_percepts(world_of(scenarios))[:, 0]
    near = seen < seen.median()
    state = replace(
        state_of(scenarios, members, near),
        current=current,
        shown=near.long(),
        outcomes=torch.zeros(40, 4).long(),
    )
    rates = torch.stack([near * 1.0, ~near * 1.0, near * 1.0, ~near * 0.5], 1)
    found = extended(stage_of(without_models()), state, rates)
    assert found is not None
    assert found.chosen == (1, 2, 0)
    assert found.branches is not None
    assert torch.equal(found.branches[1:], branches)
    before, after = current.sent_to(state.percepts), found.sent_to(state.percepts)
    assert torch.equal(after[near], before[near])
    assert (after[~near] == 1).all()
    assert branches_of(found.skill)[0] == ["m1", "m2", "m0"]  # type: ignore[index]


def test_what_the_world_has_shown_corrects_the_shares_of_replays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(team, "shares", lambda setup, state, skills: (
        torch.full((len(state.percepts), len(skills)), 0.5)
    ))  # fmt: skip
    scenarios, generator = random_scenarios("perimeter", 12, seeded(4)), seeded(5)
    members = tuple(replace(nearly(i / 10), name=f"m{i}") for i in range(3))
    keep = torch.arange(12) < 4
    trust = torch.rand(12, 3, generator=generator)
    state = replace(state_of(scenarios, members, keep), trust=trust)
    state = replace(state, shown=torch.where(torch.arange(12) == 11, -1, 0))
    setup = stage_of(without_models())
    own, last = 0.5 * trust, torch.where(state.keep, 1.0, 0.0)
    assert torch.equal(team._rates(setup, state), torch.cat([own, last[:, None]], 1))
    last = torch.where(state.shown < 0, 0.0, 0.5)
    fresh = replace(state, current=Candidate(members[1]), repeats=False)
    assert torch.equal(team._rates(setup, fresh), torch.cat([own, last[:, None]], 1))
    # In a world that repeats itself, W is solved, and who acts is as good as its member.
    last = torch.where(keep, 1.0, last)
    wanted = torch.stack([own[:, 0], last, own[:, 2], last], 1)
    again = replace(fresh, repeats=True)
    assert torch.equal(team._rates(setup, again), wanted)
    every = (torch.randn(1, BRANCH.num_parameters, generator=generator) for _ in range(99))
    skill = replace(nearly(0.7), actions=ACTIONS)
    ways = ((each, each.sent_to(state.percepts)) for each in (
        Candidate(skill, (2, 0), branches) for branches in every
    ))  # fmt: skip
    both, sent = next(way for way in ways if set(way[1][keep].tolist()) == {0, 2})
    own[torch.arange(4), sent[:4]] = 1.0
    found = team._rates(setup, replace(again, current=both))
    assert torch.equal(found, torch.cat([own, last[:, None]], 1))


def test_of_two_skills_what_the_world_has_shown_counts_beside_replays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    member, current = nearly(0.2), Candidate(nearly(0.3))
    monkeypatch.setattr(team, "_rates", lambda setup, state: torch.tensor([[1.0, 0.0]] * 5))
    scenarios = random_scenarios("near", 5, seeded(0))
    for repeats, shown, new, taken in (
        (False, [0] * 5, 0.5, False),
        (False, [0, -1, 0, 0, 0], 0.5, True),
        (False, [1] * 5, 0.8, False),
        (True, [0] * 5, 0.5, False),
        (True, [0, -1, 0, 0, 0], 0.05, False),
        (True, [-1, -1, -1, -1, 0], 0.45, True),
        (True, [1] * 5, 0.8, True),
    ):
        monkeypatch.setattr(team, "shares", lambda *_, new=new: torch.tensor([[0.5, new]] * 5))
        how = {"repeats": repeats, "shown": torch.tensor(shown), "current": current}
        found, _ = team._candidate(
            stage_of(without_models()), state_of(scenarios, (member,), **how)
        )
        assert (found is not current) is taken


def test_a_skill_that_is_reliable_everywhere_stays_and_nobody_is_evolved(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    left, current = recruited(monkeypatch, nearly(0.1)), Candidate(nearly(0.3))
    rates = torch.tensor([[1.0, RELIABLE]] * 5)
    monkeypatch.setattr(team, "_rates", lambda setup, state: rates)
    scenarios = random_scenarios("near", 5, seeded(0))
    state = state_of(scenarios, (nearly(0.2),), current=current)
    assert team._candidate(stage_of(without_models()), state)[0] is current
    rates = torch.full((5, 2), RELIABLE)
    assert team._candidate(stage_of(without_models()), state)[0] is current
    assert len(left) == 1


def test_several_candidates_are_thought_of_where_nothing_repeats_itself() -> None:
    scenarios = random_scenarios("near", 5, seeded(0))
    state = state_of(scenarios, (nearly(0.3),), repeats=False, number=4)
    with pytest.MonkeyPatch.context() as patch:
        recruited(patch)
        _, after = team.proposed(stage_of(without_models(replays=1)), state)
    assert after.number == 4 + team.THOUGHTS


@pytest.mark.parametrize("remembers", [False, True])
def test_gates_are_trained_most_where_something_was_tried(
    remembers: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = list[torch.Tensor]()

    def trained(
        branch: BranchingNN, percepts: torch.Tensor, solves: torch.Tensor, *more: torch.Tensor
    ) -> torch.Tensor:
        told.append(more[0])
        return torch.zeros(solves.shape[1] - 1, branch.num_parameters)

    monkeypatch.setattr(team, "train_gating", trained)
    members = tuple(replace(nearly(i / 10), name=f"m{i}") for i in range(2))
    state = state_of(random_scenarios("near", 4, seeded(0)), members, torch.arange(4) == 0)
    outcomes = torch.tensor([[0, 0], [0, 0], [0, 0], [1, -1]])
    state = replace(state, targets=torch.arange(4) == 1, outcomes=outcomes)
    setup = stage_of(without_models(remembers=remembers))
    found = composed(setup, state, RELIABLE * torch.eye(2).repeat(2, 1))
    assert told[0].tolist() == [3, 3, 1, team.DECIDES if remembers else 1]
    assert found.branches is not None
    about = "S1-0", list(members), found.branches, ACTIONS, setup.max_transitions
    edges = [compose(*about, corrected=each).graph.edges for each in (not remembers, remembers)]
    assert [torch.equal(found.skill.graph.edges, each) for each in edges] == [True, False]


def test_only_a_skill_with_known_branches_and_something_to_gain_is_extended() -> None:
    scenarios = random_scenarios("perimeter", 10, seeded(3))
    members = nearly(0.25), replace(nearly(0.4), name="other")
    state, rates = state_of(scenarios, members), torch.ones(10, 2)
    setup = stage_of(without_models())
    assert extended(setup, state, rates) is None
    known = replace(state, current=Candidate(members[0], (0,)))
    assert extended(setup, known, rates) is None
    alone = Candidate(members[0], (0,), torch.zeros(0, BRANCH.num_parameters))
    found = extended(setup, replace(state, current=alone), rates)
    assert found is not None
    assert found.chosen == (1, 0)
    assert extended(setup, replace(state, current=alone), RELIABLE * rates) is not None
    solved = replace(state, current=alone, keep=torch.ones(10).bool())
    assert extended(setup, solved, rates) is None
    assert extended(replace(setup, team=1), replace(state, current=alone), rates) is None


def test_the_skill_that_acts_is_extended_where_new_gates_would_lose_some_of_w(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenarios = random_scenarios("perimeter", 40, seeded(1))
    members = tuple(replace(nearly(i / 10), name=f"m{i}") for i in range(2))
    seen = first_percepts(world_of(scenarios))[:, 0]
    near = seen < seen.median()
    outcomes = torch.stack([near, ~near], 1).long() * 2 - 1
    nothing = torch.zeros(0, BRANCH.num_parameters)
    known = replace(state_of(scenarios, members, near), shown=near.long(), outcomes=outcomes)
    state = replace(known, current=Candidate(members[0], (0,), nothing))
    setup = replace(stage_of(without_models()), remembers=True)
    losing = Candidate(members[1], (1,), nothing)
    monkeypatch.setattr(team, "composed", lambda *about: losing)
    found, _ = team.proposed(setup, state)
    assert found.chosen == (1, 0)
    assert torch.equal(found.sent_to(state.percepts) == 0, near)
    better = Candidate(replace(members[0], name="better"), (0,), nothing)
    solved = replace(state, outcomes=torch.ones(40, 2).long(), shown=torch.zeros(40).long())
    monkeypatch.setattr(team, "composed", lambda *about: better)
    assert 1 not in team.proposed(setup, solved)[0].chosen  # the smaller one, if nothing is lost
