"""A world whose episodes are truncated plays as the world itself does up to the horizon."""

from inspect import getattr_static
from math import inf

import pytest
import torch
from support import seeded
from torch import Tensor
from walking import CountedPath, FewPaths, RewardedPath, chain, path, walking_actions, walks

from cgtorch.graphs import Graphs, concatenate
from cgtorch.ground.environment import Bounded, Episodic, Rewarded, Seeded, asked_of, seeds_of
from cgtorch.improvement.truncated import truncated
from cgtorch.simulation import Rollouts, rollout

ACTIONS = walking_actions()
MARKS = 1, 2, 4, 8


def walkers() -> Graphs:
    speeds = -20.0, 0.0, 10.0, 30.0
    return concatenate([chain(ACTIONS, "Aim", "Step", speed=speed) for speed in speeds])


def played(world: RewardedPath, horizon: float, marks: tuple[int, ...] = ()) -> Rollouts:
    return rollout(walkers(), ACTIONS, truncated(world, horizon, marks), max_transitions=99)


def early(world: RewardedPath, step: int) -> Tensor:
    """(P, B) returns up to a step, by walks that are that long at most."""
    shorter = walks(len(world.scenarios), seeded(1))
    lengths = world.scenarios.length.clamp_max(step)
    short = type(world)(type(shorter)(world.scenarios.place, lengths))
    found = rollout(walkers(), ACTIONS, short, max_transitions=99).returns
    assert found is not None
    return found


def test_whole_episodes_are_those_of_the_world_and_early_returns_are_known() -> None:
    world = path(0, 16)
    plain = rollout(walkers(), ACTIONS, world, max_transitions=99)
    whole = played(world, inf, MARKS)
    assert plain.returns is not None
    assert whole.returns is not None
    for name in ("succeeded", "timed_out", "percept", "transitions", "returns"):
        assert torch.equal(getattr(whole, name), getattr(plain, name))
    assert whole.executed == plain.executed
    assert torch.equal(whole.state[..., : plain.state.shape[2]], plain.state)
    steps, *marks = whole.state[..., plain.state.shape[2] :].unbind(2)
    assert torch.equal(steps, plain.transitions / 2)  # as every second action is a step
    assert len(marks) == len(MARKS)
    for step, found in zip(MARKS, marks, strict=True):
        assert torch.equal(found, early(world, step))
    assert not torch.equal(marks[0], marks[2])


@pytest.mark.parametrize("horizon", [1, 3, 5.5, 1000])
def test_an_episode_ends_at_the_horizon_at_the_latest(horizon: float) -> None:
    world = path(2, 16)
    found, step = played(world, horizon), -int(-horizon // 1)
    assert found.returns is not None
    assert torch.equal(found.returns, early(world, step))
    assert int(found.transitions.max()) <= 2 * step
    assert found.executed == int(found.transitions.sum())


def test_what_is_not_carried_out_is_no_step() -> None:
    world = truncated(path(0, 3), 2, (1,))
    nothing_to_do = chain(ACTIONS, "Step", "Step")  # as there is no message
    found = rollout(nothing_to_do, ACTIONS, world, max_transitions=40)
    assert found.returns is not None
    assert (found.returns == -inf).all()
    assert found.state[..., -2:].sum() == 0


def test_it_is_as_special_as_the_world() -> None:
    few, usual = FewPaths(walks(40, seeded(0))), CountedPath(walks(40, seeded(0)))
    bounded, free = truncated(few, inf, MARKS), truncated(usual, inf, MARKS)
    assert isinstance(bounded, Bounded)
    assert bounded.most_lanes == few.most_lanes
    assert not isinstance(free, Bounded)
    own = [getattr_static(each, "most_lanes", None) for each in (bounded, free)]
    assert [each is None for each in own] == [False, True]  # as Python 3.12 asks
    for world in (bounded, free):
        assert isinstance(world, Rewarded)
        assert isinstance(world, Episodic)
        assert isinstance(world, Seeded)
    assert torch.equal(seeds_of(free, torch.tensor([3, 5])), torch.tensor([3, 5]))
    assert asked_of(free) == asked_of(usual)
    sizes = free.num_scenarios, free.percept_size, free.control_size
    assert sizes == (40, 2, 1)
    assert free.begun == 0  # which actions of a user's own may read
    rollout(walkers(), ACTIONS, bounded, max_transitions=99)
    assert few.begun == 4 * 40
    with pytest.raises(AttributeError):
        free.unknown  # noqa: B018
