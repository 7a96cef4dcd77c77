"""This library with a learned Γ on the standard tasks; what it measures is never a test."""

from dataclasses import replace

import pytest
import torch
from standard.measure import Budget, Trial
from standard.models import TaskModels, drawn, search, setup_of
from standard.peers import UnsuitableError
from standard.rewards import GIVEN
from standard.task import Starts, Task
from standard.tasks import TASKS
from support import seeded

from cgtorch.ground.environment import start_lanes
from cgtorch.improvement.imagined import improve_imagined
from cgtorch.improvement.imagined_search import CURIOUS_STEPS, SHORT
from cgtorch.improvement.setup import Progress


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
        assert bool(((after.percept >= given.bounds[0]) & (after.percept <= given.bounds[1])).all())
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


def shortened(name: str, steps: int) -> Task:
    """A task whose episodes are imagined for so many steps only."""
    return replace(TASKS[name], most_steps=steps)


def test_it_begins_with_few_steps_in_the_world_and_counts_them() -> None:
    trial = Trial(shortened("pendulum", 50), "test", 0, Budget(1e-9, 100))
    setup = setup_of(trial)
    nothing = drawn(0, seeded(0))
    before: Progress[Starts] = Progress(None, nothing, nothing, None)
    models = TaskModels(trial.task, GIVEN["pendulum"])
    after = improve_imagined(setup, before, nothing, drawn, models)
    episodes = len(TaskModels.changes)
    steps, begun = trial.counts.world_steps, episodes * SHORT
    assert steps == len(after.knowledge.steps)
    assert begun <= steps <= begun + CURIOUS_STEPS  # with what its only generation explored
    assert trial.counts.episodes == TaskModels.looks + episodes + (steps > begun)
    assert after.knowledge.limits.circles == ((0, 1, 1.0),)


@pytest.mark.hostile
def test_a_task_is_solved_within_few_steps() -> None:
    trial = Trial(shortened("mountain_car_continuous", 250), "test", 0, Budget(300, 100))
    search(trial)
    assert trial.solved
    assert trial.counts.world_steps < 1000


def test_of_preferences_only_the_largest_counts() -> None:
    models = TaskModels(TASKS["cartpole"], GIVEN["cartpole"])
    assert models.effect(torch.tensor([[0.2, 0.1], [-3.0, -2.0]])).tolist() == [[1, 0], [0, 1]]
    models = TaskModels(TASKS["pendulum"], GIVEN["pendulum"])
    assert models.effect(torch.tensor([[0.2], [-3.0]])).tolist() == [[pytest.approx(0.2)], [-1]]


def test_it_says_of_what_it_cannot_be_tried_on() -> None:
    with pytest.raises(UnsuitableError, match="what comes next"):
        search(Trial(TASKS["repeat_first"], "test", 0, Budget(0, 0)))
