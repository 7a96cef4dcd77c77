"""An environment that is not as before the training any more is told before skills are tested."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rewarded_cart import RewardedCart
from support import create_run

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.registry import make_domain
from cgtorch.ground.errors import WorldError
from cgtorch.improvement.events import Event, FreshTested
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training
from cgtorch.training.wear import Beginning

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.spaces import Box  # noqa: E402


class Robot(gymnasium.Env[Any, Any]):
    """A robot that stands still, shows another place, or gives up, once its `charge` is used up."""

    charge, then = 10**9, "stands"

    def __init__(self) -> None:
        self.observation_space = Box(-9, 9, (1,), np.float64)
        self.action_space = Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.place = float(self.np_random.uniform(-1, 1))
        return np.array([self.place]), {}

    def step(self, action: Any) -> Any:
        self.charge -= 1
        empty = self.charge < 0
        self.place += 0.0 if empty and self.then == "stands" else 0.2 * float(action[0])
        seen = np.array([self.place + (empty and self.then == "drifts")])
        return seen, -abs(self.place), empty and self.then == "ends", False, {}


gymnasium.register("Tiny/Robot-v0", Robot, max_episode_steps=9)


def robot() -> Any:
    return make_domain("gymnasium:Tiny/Robot-v0", GymnasiumSettings(target_return=-0.1))


@pytest.mark.parametrize("then", ["stands", "drifts", "ends"])
def test_what_is_used_up_is_told(monkeypatch: pytest.MonkeyPatch, then: str) -> None:
    monkeypatch.setattr(Robot, "then", then)
    domain = robot()
    beginning = Beginning.of(domain, "starts")
    beginning.check(domain)
    for made in domain.episodes._having.values():
        made.unwrapped.charge = 0
    with pytest.raises(
        WorldError,
        match=(
            r"^environment 'Tiny/Robot-v0' does not show the same any more as before the training "
            r"\(.* after motion [12] after reset\(seed=\d+\): .*, such as a charge .* in reset\(\)$"
        ),
    ):
        beginning.check(domain)


def test_it_is_told_before_a_skill_is_tested(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    settings = RunSettings(
        domain="gymnasium:Tiny/Robot-v0",
        population=12,
        generations=2,
        attempts=1,
        max_transitions=200,
    )
    own = GymnasiumSettings("Tiny/Robot-v0", target_return=-0.1)
    run = create_run(tmp_path / "run", settings, own)
    monkeypatch.setattr(Robot, "charge", 30)  # of each copy that is made from now on
    run.domain.episodes._having.clear()
    events = list[Event]()
    training = Training(run, events.append, lambda message: nullcontext())
    with pytest.raises(WorldError, match="does not show the same any more"):
        train_until(training, Goal(target=-0.1, rounds=1))
    assert not [event for event in events if isinstance(event, FreshTested)]


def test_other_worlds_are_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    cart = RewardedCart()
    assert Beginning.of(cart, cart.kinds[0]).scenarios is None
    domain = robot()
    monkeypatch.setattr(domain, "repeats", False)
    assert Beginning.of(domain, "starts").scenarios is None
    Beginning.of(domain, "starts").check(domain)
