"""An environment of Gymnasium that tests change, and its domain."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.registry import make_domain

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.spaces import Box  # noqa: E402

Change = Callable[["Line"], Any]


class Line(gymnasium.Env[Any, Any]):
    """A point on a line; `changes` has functions of it for parts of what it returns, by name."""

    changes: dict[str, Change] = {}  # noqa: RUF012

    def __init__(self) -> None:
        self.observation_space = Box(-9, 9, (2,), np.float64)
        self.action_space = Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.place, self.steps = float(self.np_random.uniform(-1, 1)), 0
        return self._or("reset", (self._or("seen", np.array([self.place, 0.5])), {}))

    def step(self, action: Any) -> Any:
        self.steps += 1
        self.place += float(action[0])
        seen = self._or("seen", np.array([self.place, 0.5]))
        reward = self._or("reward", 1.0)
        info = self._or("info", {"good": True})
        return self._or("step", (seen, reward, self._or("over", False), False, info))

    def _or(self, name: str, value: Any) -> Any:
        return self.changes[name](self) if name in self.changes else value


gymnasium.register("Tiny/Line-v0", Line, max_episode_steps=6)


def domain_of(monkeypatch: pytest.MonkeyPatch, changes: dict[str, Change], **more: Any) -> Any:
    monkeypatch.setattr(Line, "changes", changes)
    settings = {"target_return": 5.0, **more}
    domain: Any = make_domain("gymnasium:Tiny/Line-v0", GymnasiumSettings(**settings))
    assert domain.known  # for which random episodes are played
    return domain
