"""Γ as a world with rewards, which believes it no further than its data go."""

from typing import Any

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.domains.gaussian_process import GaussianProcess
from cgtorch.domains.rewarded_model import CuriousModel, Imagined, RewardedModel
from cgtorch.ground.environment import Rewarded, start_lanes

STEP, END = 0.2, 0.9


def moved(place: Tensor, push: Tensor) -> Tensor:
    """A cart moves by what it is pushed, and something above it is lifted between 0 and 1."""
    height = (place[:, 1:] + 0.3 * push).clamp(0, 1)
    return torch.cat([place[:, :1] + STEP * push, height], 1)


def reward(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    return after[:, 0] - 2, after[:, 0] > END


@pytest.fixture(scope="module")
def gamma() -> GaussianProcess:
    g = seeded(0)
    place = torch.stack([2 * torch.rand(90, generator=g) - 1, torch.rand(90, generator=g)], 1)
    push = 2 * torch.rand(90, 1, generator=g) - 1
    return GaussianProcess(place, push, moved(place, push))


def model(gamma: GaussianProcess, kind: type[RewardedModel] = RewardedModel, **other: Any) -> Any:
    start = torch.tensor([[0.0, 0.5], [0.5, 0.2]]).double()
    return kind(Imagined(start, torch.zeros(2, 2)), gamma, reward, 5, -3.0, **other)


def test_an_imagined_episode_is_like_one_in_the_world(gamma: GaussianProcess) -> None:
    world = model(gamma)
    assert isinstance(world, Rewarded)
    lanes, place, total = (
        start_lanes(world, torch.arange(2), 0, 0),
        world.scenarios.percept.float(),
        0.0,
    )
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


def test_errors_are_the_larger_the_less_is_known(gamma: GaussianProcess) -> None:
    start, error = torch.tensor([[0.0, 0.5], [8.0, 0.5]]).double(), torch.ones(2, 2)
    world = RewardedModel(Imagined(start, error), gamma, reward, 5, 0.0)
    lanes, _ = world.step(start_lanes(world, torch.arange(2), 0, 0), torch.zeros(2, 1))
    said, _ = gamma.predict(start, torch.zeros(2, 1).double())
    off = (lanes.percept - said).abs().mean(1)
    assert off[1] > 2 * off[0]


@pytest.mark.parametrize(
    ("kind", "least", "left"),
    [(RewardedModel, -3.0, -3.0), (RewardedModel, 2.0, 0.0), (CuriousModel, -3.0, 1.0)],
)
def test_beyond_its_data_each_step_gives_the_least_or_is_what_is_wanted(
    kind: type[RewardedModel], least: float, left: float, gamma: GaussianProcess
) -> None:
    start = torch.tensor([[5000.0, 0.5]])
    world = kind(Imagined(start.double(), torch.zeros(1, 2)), gamma, reward, 5, least)
    lanes, _ = world.step(start_lanes(world, torch.arange(1), 0, 0), torch.ones(1, 1))
    assert world.over(lanes).all()
    assert torch.equal(lanes.percept, start)
    assert world.returns(lanes).tolist() == [5 * left]


def test_what_a_control_counts_for_and_what_percepts_can_be_are_the_tasks(
    gamma: GaussianProcess,
) -> None:
    world = model(gamma, effect=torch.sign, valid=lambda percept: percept.round(decimals=1))
    lanes, _ = world.step(start_lanes(world, torch.arange(2), 0, 0), torch.full((2, 1), 0.1))
    assert lanes.percept[:, 0].tolist() == pytest.approx([0.2, 0.7], abs=0.05)
    assert torch.equal(lanes.percept, lanes.percept.round(decimals=1))


def test_starts_are_those_that_are_known_and_each_is_as_frequent() -> None:
    first = torch.tensor([[0.0, 1.0], [2.0, 5.0], [3.0, 3.0]])
    drawn = Imagined.drawn(first, 9, seeded(3))
    assert sorted(drawn.percept.tolist()) == sorted(3 * first.tolist())
    assert drawn.error.shape == (9, 2)
    assert len({*Imagined.drawn(first, 2, seeded(3)).percept[:, 0].tolist()}) == 2
    others = Imagined.drawn(first, 9, seeded(4))
    assert not torch.equal(others.percept, drawn.percept)


def test_curiosity_wants_to_know_rewards_too(gamma: GaussianProcess) -> None:
    def doubt(before: Tensor, control: Tensor) -> Tensor:
        return 0.4 * (before[:, 0] > 0.2).double()

    world = model(gamma, CuriousModel, doubt=doubt)
    lanes, _ = world.step(start_lanes(world, torch.arange(2), 0, 0), torch.zeros(2, 1))
    known, unknown = world.returns(lanes).tolist()
    assert known < 0.1
    assert unknown == pytest.approx(0.4)
