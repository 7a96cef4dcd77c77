"""Rewards and ends of episodes, learned from steps."""

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.domains.learned_reward import LearnedReward, Thresholds
from cgtorch.improvement.played import Steps

FLAG, BONUS = 0.8, 100.0


def walked(count: int, seed: int = 0, flag: float = FLAG) -> Steps:
    """Steps of a cart that pays for pushes, and gets a bonus behind a flag, where they end."""
    g = seeded(seed)
    place = 2 * torch.rand(count, 2, generator=g) - 1
    push = 2 * torch.rand(count, 1, generator=g) - 1
    after = place + 0.1 * push
    ended = after[:, 0] > flag
    reward = BONUS * ended - 0.5 * push[:, 0].square() - place[:, 1].square()
    return Steps(place, push, after, reward.double(), ended)


def said(steps: Steps, model: LearnedReward) -> tuple[Tensor, Tensor]:
    return model(steps.percept.double(), steps.control.double(), steps.after.double())


def test_costs_and_a_bonus_at_the_end_are_learned() -> None:
    model, fresh = LearnedReward(walked(150)), walked(400, seed=1)
    reward, ended = said(fresh, model)
    right = ended == fresh.ended
    assert right.float().mean() > 0.98
    assert fresh.ended.any()
    assert (reward - fresh.reward)[right].abs().max() < 0.05


def test_a_single_end_tells_where_a_number_leaves_its_range() -> None:
    steps = walked(150)
    only = steps.rows(~steps.ended | (torch.arange(150) == int(steps.ended.nonzero()[0])))
    assert int(only.ended.sum()) == 1
    _, ended = said(walked(400, seed=1), LearnedReward(only))
    assert (ended == walked(400, seed=1).ended).float().mean() > 0.97


def test_before_an_end_was_seen_there_is_none() -> None:
    reward, ended = said(walked(50, seed=1), LearnedReward(walked(50, flag=9.0)))
    assert not ended.any()
    assert reward.max() < 1


def test_ends_that_no_thresholds_separate_are_learned_too() -> None:
    steps = walked(300)
    ended = steps.after.norm(dim=1) < 0.4  # in the midst of all others
    inside = Steps(steps.percept, steps.control, steps.after, steps.reward, ended)
    assert Thresholds.found(steps.after[~ended], steps.after[ended]) is None
    fresh = walked(300, seed=2)
    _, said_ended = said(fresh, LearnedReward(inside))
    assert (said_ended == (fresh.after.norm(dim=1) < 0.4)).float().mean() > 0.95


def test_each_end_gives_what_the_nearest_one_gave() -> None:
    steps = walked(300)
    good, bad = steps.after[:, 0] > 0.8, steps.after[:, 0] < -0.8
    reward = steps.reward - BONUS * steps.ended + 10.0 * good - 20.0 * bad
    both = Steps(steps.percept, steps.control, steps.after, reward, good | bad)
    model = LearnedReward(both)
    places = torch.tensor([[0.95, 0.0], [-0.95, 0.0]]).double()
    gained, ended = model(places, torch.zeros(2, 1).double(), places)
    assert ended.tolist() == [True, True]
    assert gained.tolist() == pytest.approx([10.0, -20.0], abs=0.3)


def test_rewards_that_are_all_the_same_stay_the_same_and_are_not_doubted() -> None:
    steps = walked(40, flag=9.0)
    same = Steps(steps.percept, steps.control, steps.after, torch.ones(40).double(), steps.ended)
    model = LearnedReward(same)
    assert said(walked(9, seed=3), model)[0].tolist() == [1.0] * 9
    assert model.doubt(steps.percept, steps.control).tolist() == [0.0] * 40
    beyond = steps.after[:1] + 10 * steps.after.std(0)
    assert model.doubt(beyond, steps.control[:1]) > 1  # where there may be an end
    begun = LearnedReward(same, starts=beyond)  # but not where episodes begin
    assert begun.doubt(beyond, steps.control[:1]).tolist() == [0.0]


def test_doubt_is_larger_where_nothing_was_seen() -> None:
    model = LearnedReward(walked(60, flag=9.0))
    near, far = torch.zeros(1, 2), torch.full((1, 2), 5.0)
    push = torch.zeros(1, 1)
    assert model.doubt(far, push) > 10 * model.doubt(near, push)
