"""Γ of Gymnasium environments: what actions count for, bounds, scaling and given rewards."""

import math
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from support import seeded

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.registry import full_name, with_name
from cgtorch.ground.errors import CgtorchError, DomainError, SettingsError
from cgtorch.improvement.played import Steps

gymnasium = pytest.importorskip("gymnasium")

from cgtorch.domains.gymnasium import Gymnasium  # noqa: E402
from cgtorch.domains.gymnasium_known import Known  # noqa: E402
from cgtorch.domains.gymnasium_limits import Effects  # noqa: E402
from cgtorch.domains.gymnasium_models import GymnasiumModels  # noqa: E402
from cgtorch.domains.gymnasium_world import Success  # noqa: E402
from cgtorch.domains.rewarded_models import MOST_NUMBERS  # noqa: E402

REWARDS = """
import torch

def pendulum(before, action, after):
    angle = torch.atan2(before[:, 1], before[:, 0])
    cost = angle**2 + 0.1 * before[:, 2] ** 2 + 0.001 * action[:, 0] ** 2
    return -cost, torch.zeros(len(cost), dtype=torch.bool)

def wrong(before, action, after):
    return torch.zeros(3)
"""


def models_of(environment: str, **settings: Any) -> GymnasiumModels:
    domain = Gymnasium(GymnasiumSettings(environment, **settings)).sparing()
    assert domain.models is GymnasiumModels
    return GymnasiumModels(domain)


def test_bounds_scale_what_has_some() -> None:
    domain = Gymnasium(GymnasiumSettings("MountainCarContinuous-v0")).sparing()
    scaling = domain.known.scaling
    torch.testing.assert_close(scaling.centre, torch.tensor([-0.3, 0.0]).double())
    torch.testing.assert_close(scaling.scale, torch.tensor([0.9, 0.07]).double())
    assert domain.target_return == 90
    limits = GymnasiumModels(domain).limits(torch.zeros(1, 2))
    torch.testing.assert_close(limits.low, -torch.ones(2).double())


def test_what_is_known_already_is_kept_where_steps_count() -> None:
    usual = Gymnasium(GymnasiumSettings("MountainCarContinuous-v0"))
    played = usual.known
    sparing = usual.sparing()
    assert type(sparing) is not Gymnasium
    assert sparing.known is played
    told = Success("solved")
    about = GymnasiumSettings("MountainCarContinuous-v0", success="solved")
    of_success = Gymnasium(about, Known(played.scaling, told))
    assert of_success.sparing() is of_success


def test_numbers_without_bounds_are_scaled_by_some_steps() -> None:
    models = models_of("CartPole-v1")
    scale = models.domain.known.scaling.scale
    assert scale[0] == pytest.approx(4.8)
    assert 0 < scale[1] < 2
    assert models.most_steps == 500
    assert models.limits(torch.zeros(1, 4)).high[1] == torch.inf


def test_of_actions_what_counts_is_kept() -> None:
    from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete, Tuple

    space = Tuple((Box(-1, 1, (2,)), Discrete(3), MultiDiscrete([2, 2]), MultiBinary(2)))
    effects = Effects.of(space)
    given = torch.tensor([[0.3, -0.4, 0.1, 0.9, 0.2, -3, -2, 0.5, 0.1, -0.1, 0.1]])
    assert effects.applied(given)[0].tolist() == pytest.approx(
        [0.3, -0.4, 0, 1, 0, 0, 1, 1, 0, 0, 1]
    )
    assert models_of("Pendulum-v1", target_return=-200.0).effect(
        torch.tensor([[7.0], [0.5]])
    ).tolist() == [[2.0], [0.5]]


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "given_rewards.py").write_text(REWARDS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "given_rewards", raising=False)
    return "given_rewards"


def test_given_rewards_get_observations_and_actions(mine: str) -> None:
    models = models_of("Pendulum-v1", target_return=-200.0, reward=f"{mine}:pendulum")
    env = gymnasium.make("Pendulum-v1").unwrapped
    seen, _ = env.reset(seed=3)
    scale = torch.tensor([1.0, 1.0, 8.0])
    after, wanted, *_ = env.step(torch.tensor([1.5]).numpy())
    before, then = (torch.from_numpy(x)[None] / scale for x in (seen, after))
    assert models.reward is not None
    reward, ended = models.reward(before, torch.tensor([[1.5]]), then)
    assert float(reward) == pytest.approx(float(wanted), abs=1e-4)
    assert not ended.any()
    bad = models_of("Pendulum-v1", target_return=-200.0, reward=f"{mine}:wrong")
    assert bad.reward is not None
    with pytest.raises(DomainError, match="return a tensor of 1 rewards"):
        bad.reward(before, torch.tensor([[1.5]]), then)


def test_given_rewards_are_code_that_the_name_of_the_domain_tells(mine: str) -> None:
    settings = GymnasiumSettings("Pendulum-v1", reward=f"{mine}:pendulum")
    name = full_name("gymnasium:Pendulum-v1", settings)
    assert name == f"gymnasium:Pendulum-v1+reward={mine}:pendulum"
    assert with_name(name, GymnasiumSettings("Pendulum-v1")) == settings
    with pytest.raises(DomainError, match="another reward"):
        with_name(name, GymnasiumSettings("Pendulum-v1", reward="other:one"))
    with pytest.raises(SettingsError, match=r"package\.module:function"):
        GymnasiumSettings("Pendulum-v1", reward="nothing")
    with pytest.raises(DomainError, match="cannot import reward"):
        models_of("Pendulum-v1", target_return=-200.0, reward=f"{mine}:missing")


def steps_of(rewards: list[float], ended: bool) -> Steps:
    """Steps of a pendulum at random, the last of which may end its episode."""
    n, g = len(rewards), seeded(0)
    percept, after = (torch.randn(n, 3, generator=g) for _ in range(2))
    ends = torch.arange(n) == n - 1 if ended else torch.zeros(n, dtype=torch.bool)
    return Steps(
        percept, torch.rand(n, 1, generator=g), after, torch.tensor(rewards).double(), ends
    )


def test_learned_rewards_promise_no_more_than_the_best_of_them_in_each_step(mine: str) -> None:
    models = models_of("Pendulum-v1", target_return=-200.0)
    cases = [
        ([-3.0, -1.5, -2.0], False, 10, -15.0),
        ([-3.0, -1.5, -2.0], False, 1000, -300.0),  # an episode has 200 steps
        ([-3.0, -1.5, -2.0], True, 10, -1.5),  # it may end at once
        ([-3.0, 1.5, -2.0], True, 10, 15.0),
        ([-3.0, 0.0, -2.0], False, 10, 0.0),
    ]
    for rewards, ended, steps, most in cases:
        known = models.learned(torch.zeros(1, 3), steps_of(rewards, ended))
        assert known.most(steps) == most
    given = models_of("Pendulum-v1", target_return=-200.0, reward=f"{mine}:pendulum")
    assert given.learned(torch.zeros(1, 3), steps_of([-3.0, -1.0], False)).most(10) == math.inf


def test_percepts_of_many_numbers_are_refused() -> None:
    gymnasium.register("Many-v0", entry_point=Many)
    with pytest.raises(CgtorchError, match=f"at most {MOST_NUMBERS}"):
        models_of("Many-v0", target_return=1.0)


class Many(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    observation_space = gymnasium.spaces.Box(-1, 1, (MOST_NUMBERS + 1,))
    action_space = gymnasium.spaces.Discrete(2)
