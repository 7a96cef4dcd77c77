"""This library with a learned Γ on the standard tasks; what it measures is never a test."""

from dataclasses import replace

import pytest
import torch
from standard.measure import Budget, Trial
from standard.models import (
    EPISODES,
    HORIZON,
    SHORT,
    BrokenOff,
    begun,
    fitted,
    search,
    wanted,
)
from standard.peers import UnsuitableError
from standard.rewards import GIVEN
from standard.task import Starts
from standard.tasks import TASKS
from support import seeded

from cgtorch.ground.environment import start_lanes


@pytest.mark.parametrize("name", GIVEN)
def test_rewards_that_are_given_are_those_of_the_world(name: str) -> None:
    task, given, g = TASKS[name], GIVEN[name], seeded(0)
    world = task.world(Starts(torch.arange(40)))
    lanes = start_lanes(world, torch.arange(40), 0, 0)
    ends = 0
    for _ in range(120):
        control = 2 * torch.rand(40, task.outputs, generator=g) - 1
        after, _ = world.step(lanes, control)
        live = ~world.over(lanes)  # type: ignore[attr-defined]
        gained = (world.returns(after) - world.returns(lanes))[live]  # type: ignore[attr-defined]
        reward, ended = given.reward(lanes.percept, control, after.percept)
        torch.testing.assert_close(reward[live].double(), gained, atol=2e-4, rtol=1e-4)
        assert torch.equal(ended[live], world.over(after)[live])  # type: ignore[attr-defined]
        torch.testing.assert_close(given.valid(after.percept), after.percept, atol=1e-5, rtol=0.0)
        ends += int(ended[live].sum())
        lanes = after
    assert ends == 40 or name not in ("cartpole", "double_pole")


def test_the_flag_and_the_height_end_an_episode() -> None:
    rest, there = torch.zeros(1, 2), torch.tensor([[0.9, 0.0]])
    flag, _ = GIVEN["mountain_car_continuous"].reward(rest, rest, there)
    assert flag.tolist() == [100]
    up = torch.tensor([[-1.0, 0, 1, 0, 0, 0]])
    reward, ended = GIVEN["acrobot"].reward(up, up, up)
    assert (reward.tolist(), ended.tolist()) == ([0], [True])


def test_it_begins_with_few_steps_in_the_world_and_counts_them() -> None:
    trial = Trial(TASKS["pendulum"], "test", 0, Budget(0, 100))
    search(trial)
    assert (trial.counts.episodes, trial.counts.world_steps) == (EPISODES, EPISODES * SHORT)
    assert trial.counts.evaluations == 0
    assert not trial.solved


def test_what_is_known_grows_by_episodes() -> None:
    trial = Trial(TASKS["cartpole"], "test", 0, Budget(1000, 100))
    known = begun(trial, seeded(0))
    assert len(known.first) == EPISODES
    assert len(known.rows[0]) == trial.counts.world_steps
    assert set(known.rows[1].flatten().tolist()) == {0.0, 1.0}
    more = known.learned([rows[:30] for rows in known.rows])
    assert len(more.rows[0]) == len(known.rows[0]) + 30
    assert len(more.first) == EPISODES + 1
    world = known.model(3, HORIZON, seeded(1))
    assert (world.most_steps, world.num_scenarios, world.unknown) == (500, 3, 0.0)


def test_what_came_to_a_bound_does_not_tell_how_far_it_would_go() -> None:
    g = seeded(2)
    p, u = torch.rand(60, 2, generator=g) - 0.5, 2 * torch.rand(60, 1, generator=g) - 1
    after = p + 0.3 * u
    inside = (after.abs() < 0.6).all(1)
    bounded = torch.where(inside[:, None], after, after.sign())  # thrown to a bound
    known = fitted(TASKS["mountain_car_continuous"], p[:1], (p, u, bounded))
    said, _ = known.gamma.predict(p.double(), u.double())
    torch.testing.assert_close(said[inside].float(), after[inside], atol=0.01, rtol=0.0)


def test_an_episode_is_broken_off() -> None:
    trial = Trial(TASKS["pendulum"], "test", 0, Budget(1000, 100))
    world = BrokenOff(trial.world(1), 2)
    lanes = start_lanes(world, torch.arange(1), 0, 0)
    for over in (False, True):
        lanes, _ = world.step(lanes, torch.zeros(1, 1))
        assert bool(world.over(lanes)) is over
    assert trial.counts.world_steps == 2


def test_returns_of_episodes_that_are_broken_off_are_held_against_as_much_less() -> None:
    assert wanted(TASKS["double_pole"], HORIZON) == HORIZON
    assert wanted(TASKS["pendulum"], HORIZON) == -200
    assert wanted(replace(TASKS["cartpole"], most_steps=2000), HORIZON) == 475 / 2


def test_it_says_of_what_it_cannot_be_tried_on() -> None:
    with pytest.raises(UnsuitableError, match="what comes next"):
        search(Trial(TASKS["repeat_first"], "test", 0, Budget(0, 0)))
