"""Rewards and ends of episodes, learned from steps."""

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.domains.gaussian_process import projected
from cgtorch.domains.learned_reward import LearnedReward, Thresholds, Usual
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


@pytest.mark.parametrize("gain", [0.1, 0.0])
def test_rewards_that_are_all_the_same_stay_the_same_and_are_not_doubted(gain: float) -> None:
    steps = walked(40, flag=9.0)
    every = torch.full((40,), gain, dtype=torch.float64)
    same = Steps(steps.percept, steps.control, steps.after, every, steps.ended)
    model = LearnedReward(same)
    assert said(walked(9, seed=3), model)[0].tolist() == pytest.approx([gain] * 9, abs=1e-12)
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


def test_beyond_what_was_seen_doubt_is_a_share_of_its_width() -> None:
    """Rewards are all the same, so that nothing else is in doubt; the second number never moves."""
    place = torch.tensor([[-1.0, 3.0], [0.0, 3.0], [3.0, 3.0]])
    push, no = torch.zeros(3, 1), torch.zeros(3, dtype=torch.bool)
    model = LearnedReward(Steps(place, push, place, torch.ones(3).double(), no))
    asked = torch.tensor([[-2.0, 3.0], [-1, 3], [5, 3], [0, 3.5], [0, 1], [4, 2]])
    wanted = [0.25, 0.0, 0.5, 0.5, 2.0, 1.0]
    assert model.doubt(asked, torch.zeros(6, 1)).tolist() == pytest.approx(wanted)


def test_thresholds_are_midway_and_as_few_as_can_be() -> None:
    going = torch.tensor([[0.0, 5.0], [1.0, 6.0]]).double()
    above, below = torch.tensor([[3.0, 5.5]]).double(), torch.tensor([[0.5, 1.0]]).double()
    assert Thresholds.found(going, above) == Thresholds(((0, 1, 2.0),))
    both = Thresholds.found(going, torch.cat([above, above + 1, below]))
    assert both is not None
    assert sorted(both.limits) == [(0, 1, 2.0), (1, -1, -3.0)]
    asked = torch.tensor([[2.1, 5.0], [1.9, 5.0], [0.5, 3.1], [0.5, 2.9], [9.0, 0.0]]).double()
    assert both(asked).tolist() == [True, False, False, True, True]
    # One threshold of the second number is enough, although one of the first has some of them.
    some = torch.tensor([[3.0, 9.0], [3.0, 9.0], [0.5, 9.0]]).double()
    assert Thresholds.found(going, some) == Thresholds(((1, 1, 7.5),))


def test_an_end_at_the_edge_of_others_is_beyond_no_threshold() -> None:
    going = torch.tensor([[0.0], [1.0]]).double()
    for edge in (0.0, 1.0, 0.5):
        assert Thresholds.found(going, torch.tensor([[edge]]).double()) is None
        mixed = torch.tensor([[edge], [2.0]]).double()
        assert Thresholds.found(going, mixed) is None


def test_where_all_steps_are_ends_none_is_told_from_others() -> None:
    steps = walked(40)
    every = torch.ones(40, dtype=torch.bool)
    model = LearnedReward(Steps(steps.percept, steps.control, steps.after, steps.reward, every))
    assert not said(walked(20, seed=1), model)[1].any()


def test_numbers_and_their_deviations_are_those_of_the_projected_process() -> None:
    g = seeded(5)
    x = 2 * torch.rand(40, 2, generator=g).double()
    y = 3 + x[:, 0].sin() - x[:, 1] ** 2 + 0.01 * torch.randn(40, generator=g).double()
    model = Usual(x, y, None)
    asked = 2 * torch.rand(30, 2, generator=g).double()
    kernel, rows, at = model.kernel, *((each - model.mean) / model.scale for each in (x, asked))
    shift, spread = y.mean(), y.std(correction=0)
    weights, known = projected(kernel, model.pivots, rows, ((y - shift) / spread)[:, None])
    across = kernel(at, model.pivots)
    mean = shift + spread * (across @ weights)[:, 0]
    torch.testing.assert_close(model(asked), mean, atol=1e-6, rtol=0.0)
    variance = kernel.alone(at) - (across @ known).square().sum(1)
    torch.testing.assert_close(model.deviation(asked), variance.sqrt(), atol=1e-6, rtol=1e-6)
    truth = 3 + asked[:, 0].sin() - asked[:, 1] ** 2
    assert float((model(asked) - truth).abs().mean()) < 0.05


def test_a_later_fit_goes_on_from_an_earlier_one() -> None:
    steps = walked(60, flag=9.0)
    first = LearnedReward(steps)
    again = LearnedReward(steps, first.free)
    torch.testing.assert_close(again.free, first.free, atol=0.3, rtol=0.0)
    far = LearnedReward(steps, first.free + 3)
    assert not torch.equal(far.free, first.free + 3)
    same = Steps(steps.percept, steps.control, steps.after, torch.ones(60).double(), steps.ended)
    assert torch.equal(LearnedReward(same, first.free).free, first.free), "nothing was fitted"
