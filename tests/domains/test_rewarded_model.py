"""Γ as a world with rewards, which believes it no further than its data go."""

from typing import Any

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.domains.posterior import MOST_PIVOTS, NUGGET, Posterior
from cgtorch.domains.rewarded_model import CuriousModel, Imagined, RewardedModel
from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.environment import Rewarded, start_lanes
from cgtorch.environment.fields import Field
from cgtorch.svm.gram import rbf

STEP, END = 0.2, 0.9
FIELDS = (Field("place", "m"), Field("height", "m", 0, 1))


def moved(place: Tensor, push: Tensor) -> Tensor:
    """A cart moves by what it is pushed, and something above it is lifted between 0 and 1."""
    height = (place[:, 1:] + 0.3 * push).clamp(0, 1)
    return torch.cat([place[:, :1] + STEP * push, height], 1)


def reward(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    return after[:, 0] - 2, after[:, 0] > END


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    g = seeded(0)
    place = torch.stack([2 * torch.rand(90, generator=g) - 1, torch.rand(90, generator=g)], 1)
    push = 2 * torch.rand(90, 1, generator=g) - 1
    gamma = KernelTransitionModel(FIELDS, (Field("push", "m", -1, 1),))
    fit_transition_model(gamma, place, push, moved(place, push))
    return Posterior(gamma.float(), place, push)


def model(posterior: Posterior, kind: type[RewardedModel] = RewardedModel, **other: Any) -> Any:
    start = torch.tensor([[0.0, 0.5], [0.5, 0.2]])
    return kind(Imagined(start, torch.zeros(2, 2)), posterior, reward, 5, -3.0, **other)


def test_variances_are_those_of_a_gaussian_process(posterior: Posterior) -> None:
    g = seeded(1)
    place, push = 3 * torch.rand(20, 2, generator=g) - 1, torch.rand(20, 1, generator=g)
    known = posterior.pivots.double()
    assert len(known) <= min(90, MOST_PIVOTS)
    asked = posterior.gamma.features(place, push).double()
    across = rbf(asked, known, posterior.width)
    gram = rbf(known, known, posterior.width) + NUGGET * torch.eye(len(known))
    plain = 1 - (across * torch.linalg.solve(gram, across.T).T).sum(1)
    after, variance = posterior.predict(place, push)
    torch.testing.assert_close(variance, plain.float(), atol=2e-3, rtol=0.0)
    torch.testing.assert_close(after, posterior.gamma(place, push), atol=1e-5, rtol=0.0)


def test_it_is_sure_of_its_data_and_of_nothing_far_off(posterior: Posterior) -> None:
    g = seeded(2)
    place, push = torch.rand(50, 2, generator=g), 2 * torch.rand(50, 1, generator=g) - 1
    assert posterior.predict(place, push)[1].max() < 0.02
    assert posterior.predict(place + 100, push)[1].min() > 0.99
    none, one = posterior.deviation(torch.tensor([NUGGET / 2, 1.0])).tolist()
    assert none == 0
    assert one > 1


def test_an_imagined_episode_is_like_one_in_the_world(posterior: Posterior) -> None:
    world = model(posterior)
    assert isinstance(world, Rewarded)
    lanes, place, total = start_lanes(world, torch.arange(2), 0, 0), world.scenarios.percept, 0.0
    for _ in range(5):
        push = torch.full((2, 1), 0.4)
        lanes, _ = world.step(lanes, push)
        place = moved(place, push)
        total = total + reward(place, push, place)[0]
    torch.testing.assert_close(lanes.percept[0], place[0], atol=0.05, rtol=0.0)
    assert world.over(lanes).tolist() == [True, True]
    assert float(world.returns(lanes)[0]) == pytest.approx(float(total[0]), abs=0.2)  # type: ignore[index]
    again, _ = world.step(lanes, push)
    assert torch.equal(again.state, lanes.state)


def test_errors_are_the_larger_the_less_is_known(posterior: Posterior) -> None:
    start, error = torch.tensor([[0.0, 0.5], [1.05, 0.5]]), torch.ones(2, 2)
    world = RewardedModel(Imagined(start, error), posterior, reward, 5, 0.0)
    lanes, _ = world.step(start_lanes(world, torch.arange(2), 0, 0), torch.zeros(2, 1))
    off = (lanes.percept - posterior.gamma(start, torch.zeros(2, 1))).abs().mean(1)
    assert off[1] > 2 * off[0]


@pytest.mark.parametrize(("kind", "left"), [(RewardedModel, -3.0), (CuriousModel, 1.0)])
def test_beyond_its_data_each_step_gives_the_least_or_is_what_is_wanted(
    kind: type[RewardedModel], left: float, posterior: Posterior
) -> None:
    start = torch.tensor([[50.0, 0.5]])
    world = kind(Imagined(start, torch.zeros(1, 2)), posterior, reward, 5, -3.0)
    lanes, _ = world.step(start_lanes(world, torch.arange(1), 0, 0), torch.ones(1, 1))
    assert world.over(lanes).all()
    assert torch.equal(lanes.percept, start)
    assert world.returns(lanes).tolist() == [5 * left]


def test_what_a_control_counts_for_and_what_percepts_can_be_are_the_tasks(
    posterior: Posterior,
) -> None:
    world = model(posterior, effect=torch.sign, valid=lambda percept: percept.round(decimals=1))
    lanes, _ = world.step(start_lanes(world, torch.arange(2), 0, 0), torch.full((2, 1), 0.1))
    assert lanes.percept[:, 0].tolist() == pytest.approx([0.2, 0.7], abs=0.05)
    assert torch.equal(lanes.percept, lanes.percept.round(decimals=1))


def test_starts_are_used_in_turn() -> None:
    first = torch.arange(3.0)[:, None]
    drawn = Imagined.drawn(first, 7, seeded(3))
    assert sorted(int((drawn.percept == k).sum()) for k in range(3)) == [2, 2, 3]
    assert drawn.error.shape == (7, 1)
