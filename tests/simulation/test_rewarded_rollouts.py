"""Rollouts where there are rewards: they end with the episode, and only a whole one has a return.

What is expected comes from rollouts in the same world without rewards, of which every action is
looked at: where the episode of a lane is over for the first time, the lane has to have ended.
"""

from collections import Counter as Count

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import nested_actions, random_graphs, seeded
from told_by_runs import tensors_of
from torch import Tensor
from walking import END, GAINED, NEAR, PLACE, Path, RewardedPath, Walks, chain, is_over, path
from walking import walking_actions as walking

from cgtorch.graphs import ActionSet, Graphs, Skill, SubSkill
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Environment, Lanes, Rewarded, start_lanes
from cgtorch.ground.errors import WorldError
from cgtorch.improvement.trial import try_skill
from cgtorch.simulation import (
    MAX_STEPS,
    Recording,
    Rollouts,
    most_steps,
    rollout,
)
from cgtorch.simulation.compiled import LARGEST
from cgtorch.simulation.torch_engine import MOST_IDLE, Trace
from cgtorch.tabletop.actions import Detect

SETS = [walking(), nested_actions(0, walking(), limits=(4, 9))]


def expected(
    graphs: Graphs, actions: ActionSet, place: RewardedPath, limit: int, steps: int
) -> tuple[dict[str, Tensor], Count[str]]:
    """What rollouts have to come to, and how many lanes end how."""
    states: list[list[Tensor]] = [[] for _ in range(len(graphs) * place.num_scenarios)]

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        for lane, state in zip(active.tolist(), lanes.state, strict=True):
            states[lane].append(state.clone())

    plain = rollout(
        graphs, actions, Path(place.scenarios), max_transitions=limit, max_steps=steps, trace=trace
    )
    assert plain.returns is None
    wanted = {name: value.flatten(0, 1).clone() for name, value in tensors_of(plain).items()}
    wanted["returns"] = torch.full((len(states),), -torch.inf)
    ends: Count[str] = Count()
    for lane, history in enumerate(states):
        last = next((i for i, state in enumerate(history) if is_over(state[None])), None)
        if last is None:
            ends["before"] += 1
            continue
        state = history[last]
        good = bool(state[PLACE].abs() < NEAR)
        ends["good" if good else "fallen" if state[PLACE].abs() > END else "bad"] += 1
        ends["earlier"] += last + 1 < int(wanted["transitions"][lane])
        wanted["succeeded"][lane], wanted["timed_out"][lane] = good, False
        wanted["transitions"][lane] = last + 1
        wanted["state"][lane], wanted["percept"][lane] = state, state[:2]
        wanted["returns"][lane] = state[GAINED]
    shape = plain.succeeded.shape
    return {name: value.view(*shape, *value.shape[1:]) for name, value in wanted.items()}, ends


@given(
    seed=st.integers(0, 2**31),
    actions=st.sampled_from(SETS),
    limit=st.integers(1, 30),
    steps=st.integers(1, MOST_IDLE),
)
@settings(max_examples=12)
def test_lanes_end_with_their_episodes_and_no_others_change(
    seed: int, actions: ActionSet, limit: int, steps: int
) -> None:
    graphs, place = random_graphs(seed, 12, actions), path(seed, 5)
    found = rollout(graphs, actions, place, max_transitions=limit, max_steps=steps)
    wanted, _ = expected(graphs, actions, place, limit, steps)
    assert tensors_of(found).keys() == wanted.keys()
    for name, value in tensors_of(found).items():
        # Networks round otherwise where they are compiled, and walks go on from there.
        exact = {"atol": 1e-5, "rtol": 1e-5} if value.is_floating_point() else {}
        torch.testing.assert_close(value, wanted[name], **exact, msg=name)


@pytest.mark.parametrize("actions", SETS)
def test_the_comparison_meets_every_end(actions: ActionSet) -> None:
    _, ends = expected(random_graphs(1, 200, actions), actions, path(1, 5, longest=4), 20, 60)
    assert min(ends[end] for end in ("before", "good", "bad", "fallen", "earlier")) >= 5, ends


def test_an_episode_that_is_over_in_a_sub_skill_ends_every_level() -> None:
    base, place = walking(), RewardedPath(Walks(torch.tensor([1.0, -2.0]), torch.tensor([4.0, 6])))
    flat = chain(base, "Aim", "Step", speed=0.25)
    inner = Skill("inner", flat, base, max_transitions=5)
    one = base.extended(["inner"], [SubSkill(inner)])
    middle = Skill("middle", chain(one, "inner", "Branch"), one, max_transitions=50)
    actions = one.extended(["middle"], [SubSkill(middle)])
    runs = rollout(chain(actions, "middle", "Branch"), actions, place)
    # Two steps at a time, as the inner skill's fifth transition is its last, then a branch.
    assert runs.transitions.tolist() == [[5 + 1 + 4, 5 + 1 + 5 + 1 + 4]]
    assert not runs.timed_out.any()
    assert runs.succeeded.tolist() == [[False, False]]
    assert runs.returns is not None
    assert runs.returns.tolist() == [
        [-(1.25 + 1.5 + 1.75 + 2), -(1.75 + 1.5 + 1.25 + 1 + 0.75 + 0.5)]
    ]


def test_success_is_what_the_world_says_at_the_end() -> None:
    actions = walking()
    place = RewardedPath(Walks(torch.tensor([0.0, 1.0, 2.9]), torch.tensor([3.0, 3.0, 3.0])))
    runs = rollout(chain(actions, "Aim", "Step", speed=0.1), actions, place)
    assert runs.succeeded.tolist() == [[True, False, False]]
    assert runs.transitions.tolist() == [[6, 6, 4]]  # the last one falls
    assert not runs.timed_out.any()


def test_a_skill_that_ends_before_its_episode_gets_no_return() -> None:
    """However well it stands there: success by a test does not finish the walk."""
    actions = walking()
    place = RewardedPath(Walks(torch.tensor([0.0]), torch.tensor([5.0])))
    runs = rollout(chain(actions, "Test"), actions, place)
    assert runs.succeeded.all()
    assert tensors_of(runs)["returns"].tolist() == [[-torch.inf]]
    ended = rollout(chain(actions, "Aim", "Step"), actions, place, max_transitions=9)
    assert ended.timed_out.all()
    assert tensors_of(ended)["returns"].tolist() == [[-torch.inf]]
    whole = rollout(chain(actions, "Aim", "Step"), actions, place, max_transitions=10)
    assert tensors_of(whole)["returns"].tolist() == [[0.0]]
    assert whole.succeeded.all()


@pytest.mark.parametrize("trace", [None, lambda *seen: None])
@pytest.mark.parametrize("bad", [torch.nan, torch.inf, 1e39])
def test_returns_that_are_not_finite_are_told(bad: float, trace: Trace | None) -> None:
    class Odd(RewardedPath):
        def returns(self, lanes: Lanes) -> Tensor:
            return torch.where(lanes.scenario == 1, bad, super().returns(lanes).double())

    actions = walking()
    place = Odd(Walks(torch.zeros(2), torch.ones(2)))
    with pytest.raises(WorldError, match=r"Odd.returns gave (nan|inf) for scenario 1 after 2 act"):
        rollout(chain(actions, "Aim", "Step"), actions, place, trace=trace)
    runs = rollout(chain(actions, "Aim"), actions, place, trace=trace)  # which ends no episode
    assert runs.returns is not None
    assert (runs.returns == -torch.inf).all()


@given(st.integers(0, 2**31), st.sampled_from(SETS))
@settings(max_examples=10)
def test_a_result_does_not_depend_on_the_rest_of_the_batch(seed: int, actions: ActionSet) -> None:
    graphs, place = random_graphs(seed, 12, actions), path(seed, 8)
    everything = rollout(graphs, actions, place)
    some = torch.randperm(12, generator=seeded(seed))[:5]
    where = torch.randperm(8, generator=seeded(seed))[:3]
    part = rollout(graphs[some], actions, place, scenarios=where)
    for name, value in tensors_of(part).items():
        assert torch.equal(value, tensors_of(everything)[name][some][:, where]), name


class Restless(Detect):
    """Does nothing, but could do something else next time."""

    deterministic: bool = False


def test_who_only_thinks_is_given_up() -> None:
    """Episodes can be thousands of actions long; without rewards nobody is in a hurry."""
    actions = walking().extended(["Think"], [Restless()])
    scenarios = Walks(torch.zeros(1), torch.full((1,), 3.0))
    graph = chain(actions, "Think")
    runs = rollout(graph, actions, RewardedPath(scenarios), max_transitions=500)
    assert runs.transitions.tolist() == [[MOST_IDLE + 1]]
    assert runs.timed_out.all()
    assert tensors_of(runs)["returns"].tolist() == [[-torch.inf]]
    assert rollout(graph, actions, Path(scenarios), max_transitions=500).transitions.item() == 500
    slow = chain(actions, "Aim", "Step", *["Think"] * (MOST_IDLE - 1))
    runs = rollout(slow, actions, RewardedPath(scenarios), max_transitions=500)
    assert runs.succeeded.all()
    assert runs.transitions.tolist() == [[2 * (MOST_IDLE + 1) + 2]]


def test_recordings_pass_rewards_on_and_keep_the_experience() -> None:
    place, actions = path(2, 20), walking()
    graph = chain(actions, "Aim", "Step", speed=0.2)
    recording = Recording(place)
    assert isinstance(recording, Rewarded)
    found, plain = (rollout(graph, actions, e, max_transitions=24) for e in (recording, place))
    assert not found.timed_out.any()
    for name, value in tensors_of(plain).items():
        assert torch.equal(tensors_of(found)[name], value), name
    percept, control, after, tested, succeeded = recording.experience()
    steps = int(found.state[..., 1].sum())
    assert percept.shape == after.shape == (steps, 2)
    assert (control == 0.2).all()
    assert (after[:, 0] - percept[:, 0] - 0.2).abs().max() < 1e-6
    # What is asked at the ends of episodes are tests of success, too, one for each.
    assert int(succeeded.sum()) == int(found.succeeded.sum())
    assert sorted(tested.tolist()) == sorted(found.percept[0].tolist())


def test_a_recording_of_a_world_without_rewards_gives_none() -> None:
    plain = Recording(Path(path(0, 3).scenarios))
    assert type(plain) is Recording
    assert not isinstance(plain, Rewarded)
    assert isinstance(plain, Environment)


def test_trials_tell_returns_and_what_they_cost() -> None:
    place, actions = path(4, 10), walking()
    skill = Skill("walk", chain(actions, "Aim", "Step", speed=-0.1), actions, max_transitions=40)
    purse = Purse()
    trial = try_skill(skill, place, purse)
    assert trial.returns is not None
    assert trial.returns.isfinite().all()
    assert (trial.returns <= 0).all()
    assert torch.equal(trial.percepts, place.start(torch.arange(10))[1])
    moves, ends = len(trial.experience.percept), len(trial.experience.tested)
    assert moves > ends == 10  # one test at the end of each episode
    assert purse.spent == {"trials": Asked(motions=moves, tests=10, looks=10, episodes=10)}
    assert trial.asked == purse.total
    assert torch.equal(trial.actions, place.scenarios.length.long() + 1)
    assert try_skill(skill, Path(place.scenarios)).returns is None


def test_as_many_actions_as_the_limits_of_all_levels_allow() -> None:
    base = walking().extended(["Think"], [Restless()])
    assert most_steps(base, 20) == most_steps(base, 3) == MAX_STEPS
    assert most_steps(base, 50) == 2500
    inner = Skill("inner", chain(base, "Think"), base, max_transitions=60)
    actions = base.extended(["inner"], [SubSkill(inner)])
    assert most_steps(actions, 20) == 1200
    outer = Skill("outer", chain(actions, "inner"), actions, max_transitions=5)
    assert most_steps(actions.extended(["outer"], [SubSkill(outer)]), 20) == 1200
    assert most_steps(base, 10**9) == LARGEST

    def transitions(**limits: int) -> int:
        place = Path(Walks(torch.zeros(1), torch.ones(1)))
        runs: Rollouts = rollout(chain(actions, "inner"), actions, place, **limits)
        assert runs.timed_out.all()
        return int(runs.transitions)

    assert transitions() == 20 * 60
    assert transitions(max_transitions=15) == 15 * 60
    assert transitions(max_steps=70) == 70


class Doubtful(RewardedPath):
    """One in which walks of any kind end with this success."""

    chance = 0.45

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        return lanes, torch.full((len(lanes),), self.chance)


@pytest.mark.parametrize("trace", [None, lambda *seen: None])
@pytest.mark.parametrize(("chance", "succeeds"), [(0.45, False), (0.5, False), (0.55, True)])
def test_an_episode_has_succeeded_from_more_than_a_half_on(
    chance: float, succeeds: bool, trace: Trace | None
) -> None:
    actions, place = walking(), Doubtful(Walks(torch.zeros(2), torch.ones(2)))
    place.chance = chance
    runs = rollout(chain(actions, "Aim", "Step"), actions, place, trace=trace)
    assert runs.succeeded.tolist() == [[succeeds, succeeds]]
    recording = Recording(place)
    lanes = start_lanes(recording, torch.arange(2), 1, 0)
    recording.success(lanes)
    assert recording.experience()[4].tolist() == [succeeds, succeeds]


@pytest.mark.parametrize("trace", [None, lambda *seen: None])
def test_an_episode_that_is_over_at_its_start_ends_after_one_action(trace: Trace | None) -> None:
    actions, place = walking(), RewardedPath(Walks(torch.zeros(2), torch.tensor([0.0, 5.0])))
    runs = rollout(chain(actions, "Aim", "Step"), actions, place, trace=trace)
    assert runs.transitions[0, 0] == 1
    assert runs.returns is not None
    assert runs.returns[0, 0] == 0
    assert runs.transitions[0, 1] > 1


@pytest.mark.parametrize("before", [True, False])
def test_hooks_of_a_step_are_called(before: bool) -> None:
    actions, place = walking(), RewardedPath(Walks(torch.zeros(2), torch.full((2,), 3.0)))
    step, called = actions.actions[actions.index("Step")], list[bool]()
    if before:
        hook = step.register_forward_pre_hook(lambda *given: called.append(True))
    else:
        hook = step.register_forward_hook(lambda *given: called.append(True))
    try:
        rollout(chain(actions, "Aim", "Step"), actions, place)
    finally:
        hook.remove()
    assert called
