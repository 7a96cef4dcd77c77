"""What is known of a world with rewards: fitted to steps, kept in tensors, and told in a line."""

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch import Field
from cgtorch.domains import gaussian_process, learned_reward
from cgtorch.domains.rewarded_model import CuriousModel, RewardedModel
from cgtorch.domains.rewarded_models import MOST_NUMBERS, NAMES, Known, RewardedModels
from cgtorch.ground.errors import DomainError, RunError, SettingsError
from cgtorch.improvement.played import Steps

CART: Any = SimpleNamespace(
    percept=(Field("place", "m"), Field("speed", "m/s")), control=(Field("push", "", -1, 1),)
)


def steps_of(count: int, seed: int = 0) -> Steps:
    """A cart is pushed, sometimes more than it can be; it ends at 0.6 m, and far off costs."""
    g = seeded(seed)
    before = 2 * torch.rand(count, 2, generator=g) - 1
    push = 3 * torch.rand(count, 1, generator=g) - 1.5
    speed = 0.9 * before[:, 1:] + 0.2 * push.clamp(-1, 1)
    after = torch.cat([before[:, :1] + 0.3 * speed, speed], 1)
    return Steps(before, push, after, -1 - after[:, 0].double().abs(), after[:, 0] > 0.6)


def given_reward(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    return after[:, 0], after[:, 0] > 0.9


class Given(RewardedModels[Any]):
    """Models that are told the rewards."""

    reward = staticmethod(given_reward)
    most_steps = 12


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Fits end after few steps, as they need not be good."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (gaussian_process, learned_reward):
            patch.setattr(module, "STEPS", 4)
            patch.setattr(module, "AGAIN", 2)
        yield


@pytest.fixture(scope="module")
def known(quick: None) -> Known:
    return RewardedModels(CART).learned(torch.zeros(3, 2), steps_of(30))


def test_controls_count_as_far_as_their_bounds(known: Known) -> None:
    assert known.steps.control.abs().max() == 1
    models = known.models
    assert models.effect(torch.tensor([[5.0], [0.5], [-2.0]])).tolist() == [[1], [0.5], [-1]]
    here = torch.zeros(1, 2)
    drawn = torch.cat([models.random_control(here, seeded(seed)) for seed in range(20)])
    assert drawn.shape == (20, 1)
    assert drawn.abs().max() <= 1
    assert len(drawn.unique()) == 20


def test_a_percept_that_cannot_be_learned_from_is_named() -> None:
    fields = tuple(Field(f"x{i}") for i in range(MOST_NUMBERS))
    RewardedModels(SimpleNamespace(percept=fields, control=CART.control))
    with pytest.raises(SettingsError, match=f"percepts have {MOST_NUMBERS + 1} numbers, and Γ"):
        RewardedModels(SimpleNamespace(percept=(*fields, Field("y")), control=CART.control))
    turning = Field("place"), Field("lamp", "rad", kind="angle")
    with pytest.raises(DomainError, match="percept 'lamp' is an angle, which jumps"):
        RewardedModels(SimpleNamespace(percept=turning, control=CART.control))


def test_what_is_known_goes_through_tensors(known: Known) -> None:
    later = known.refused().refused()
    assert (known.offered, later.offered) == (0, 2)
    tensors = later.tensors()
    assert tuple(tensors) == NAMES
    assert len(tensors["gamma"]) == len(tensors["reward"]) == 0  # as the fits began as usual
    again = known.models.recalled(tensors)
    assert again.offered == 2
    asked = known.steps.percept[:5], known.steps.control[:5]
    one, other = (each.gamma.predict(*asked)[0] for each in (known, again))
    assert torch.equal(one, other)
    for name in NAMES:
        broken = {key: value for key, value in tensors.items() if key != name}
        with pytest.raises(RunError, match="the stored steps in the world are damaged"):
            known.models.recalled(broken)
    with pytest.raises(RunError, match="are damaged"):
        known.models.recalled({**tensors, "gamma": torch.zeros(2).double()})


def test_further_steps_come_last_and_fits_go_on(known: Known) -> None:
    more = known.refused().after(torch.ones(2, 2), steps_of(10, 1))
    assert len(more.steps) == 40
    assert torch.equal(more.steps.percept[:30], known.steps.percept)
    assert more.steps.control.abs().max() == 1
    assert more.starts.tolist() == [[0, 0]] * 3 + [[1, 1]] * 2
    assert more.offered == 1
    begun = more.begun
    assert begun[0] is known.gamma.free
    assert begun[1] is known.reward.free  # type: ignore[attr-defined]
    tensors = more.tensors()
    assert torch.equal(tensors["gamma"], known.gamma.free)
    assert torch.equal(tensors["reward"], known.reward.free)  # type: ignore[attr-defined]


def test_no_episode_is_promised_more_than_its_best_steps_have_given(known: Known) -> None:
    best = float(known.steps.reward.max())
    assert known.steps.ended.any()
    assert best < 0
    assert known.most(7) == best  # as an episode may end at once
    going = steps_of(30)
    going.ended[:] = False
    endless = RewardedModels(CART).learned(torch.zeros(1, 2), going)
    assert endless.most(7) == pytest.approx(7 * best)
    endless.models.most_steps = 3
    assert endless.most(7) == pytest.approx(3 * best)
    endless.steps.reward[:] = 2.0
    assert endless.most(7) == 6.0
    assert Given(CART).learned(torch.zeros(1, 2), steps_of(30)).most(7) == math.inf


def test_worlds_begin_at_the_starts_and_are_no_longer_than_the_real_one(known: Known) -> None:
    world = known.world(5, 40, seeded(0))
    assert type(world) is RewardedModel
    assert world.num_scenarios == 5
    assert world.scenarios.percept.tolist() == [[0, 0]] * 5
    assert world.most_steps == 40
    assert world.unknown == float(known.steps.reward.min())
    assert torch.equal(world.effect(torch.full((1, 1), 9.0)), torch.ones(1, 1))
    curious = known.curious(4, 40, seeded(0))
    assert type(curious) is CuriousModel
    assert curious.doubt == known.reward.doubt  # type: ignore[attr-defined]
    there = known.begun_at(torch.full((1, 2), 0.5), 3, 40, seeded(0))
    assert there.scenarios.percept.tolist() == [[0.5, 0.5]] * 3
    given = Given(CART).learned(torch.zeros(1, 2), steps_of(30))
    assert given.reward is given_reward
    assert given.world(2, 40, seeded(0)).most_steps == 12
    assert given.curious(2, 7, seeded(0)).doubt is None  # type: ignore[attr-defined]
    assert given.curious(2, 7, seeded(0)).most_steps == 7
    assert not given.world(2, 7, seeded(0)).succeeded(torch.ones(2, 5)).any()


def test_what_was_learned_is_told_and_warned_of_where_percepts_hardly_tell(known: Known) -> None:
    ends = int(known.steps.ended.sum())
    noise = float(known.gamma.kernel.noise.sqrt())
    assert known.summary() == (
        f"Γ of 30 steps, noise {noise:.2%} of the changes, rewards and {ends} ends learned from "
        "them"
    )
    given = Given(CART).learned(torch.zeros(1, 2), steps_of(30))
    assert "learned from" not in given.summary()
    gamma: Any = SimpleNamespace(kernel=SimpleNamespace(noise=torch.tensor(0.16)))
    vague = replace(known, gamma=gamma)
    assert vague.noise == pytest.approx(0.4)
    assert "; percepts hardly tell what comes next" in vague.summary()


def test_steps_into_what_is_impossible_teach_gamma_nothing() -> None:
    """A next percept at a bound is no example, unless there is no other."""
    bounded: Any = SimpleNamespace(
        percept=(Field("place", "m", -2, 2), Field("speed", "m/s", -2, 2)), control=CART.control
    )
    plain, models = steps_of(20), RewardedModels(bounded)
    wild = Steps(*(value.clone() for value in vars(plain).values()))
    wild.after[:8, 0] = 500.0
    found, alone = (
        models.learned(torch.zeros(1, 2), steps)
        for steps in (wild, plain.rows(torch.arange(20) >= 8))
    )
    assert torch.equal(found.gamma.free, alone.gamma.free)
    wild.after[:10, 0], wild.after[10:, 1] = 500.0, 500.0
    assert models.learned(torch.zeros(1, 2), wild).gamma.free.isfinite().all()
