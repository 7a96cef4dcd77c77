"""Tiny Gymnasium environments with all kinds of spaces; importing the module registers them."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

GOAL, ZOO, TALK, MUTE, DRAWN = (
    f"tiny_worlds:Tiny/{name}-v0" for name in ("Goal", "Zoo", "Talk", "Mute", "Drawn")
)


class Goal(gymnasium.Env[Any, Any]):
    """A point that is pushed to a goal, as in goal environments; its mission is a text."""

    def __init__(self, speed: float = 0.5, says: str = "is_success", value: Any = None) -> None:
        """A point with this speed; the info `says` whether it is there, or some other `value`."""
        place = spaces.Box(-2, 2, (2,), np.float64)
        self.observation_space = spaces.Dict(
            observation=spaces.Box(-4, 4, (2,), np.float64),
            achieved_goal=place,
            desired_goal=place,
            mission=spaces.Text(9),
        )
        self.action_space = spaces.Box(-1, 1, (2,), np.float64)
        self.speed, self.says, self.value = speed, says, value

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.goal = self.np_random.uniform(-1, 1, (2, 2))
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self.place = np.clip(self.place + self.speed * action, -2, 2)
        distance = float(np.linalg.norm(self.place - self.goal))
        there = distance < 0.2
        return self._seen(), -distance, False, False, {self.says: self.value or there}

    def _seen(self) -> dict[str, Any]:
        places = {"observation": self.place * 2, "achieved_goal": self.place}
        return {**places, "desired_goal": self.goal, "mission": "go"}


class Zoo(gymnasium.Env[Any, Any]):
    """One of each space, and actions of each; it shows random observations."""

    def __init__(self) -> None:
        matrix, pair = spaces.Box(-9, 9, (2, 2), np.float32), spaces.MultiDiscrete([2, 3])
        number, bits = spaces.Box(-3, 3, (), np.float32), spaces.MultiBinary(2)
        inner = spaces.Dict({"level": spaces.Discrete(3, start=1), "matrix": matrix})
        self.observation_space = spaces.Tuple([bits, inner, pair, number])
        both = spaces.Tuple([spaces.Discrete(2, start=5), spaces.Box(-1, 1, (1,), np.float32)])
        self.action_space = spaces.Dict({"arm": matrix, "both": both, "keys": pair, "lamps": bits})
        self.played = list[Any]()

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self.played.append(action)
        return self.observation_space.sample(), 1.0, False, False, {}


class Talk(Goal):
    """One whose actions are texts."""

    def __init__(self) -> None:
        super().__init__()
        self.action_space = spaces.Dict(word=spaces.Text(5))  # type: ignore[assignment]


class Mute(Goal):
    """One that shows a text only."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_space = spaces.Text(5)  # type: ignore[assignment]


class Drawn(Goal):
    """One that draws pictures, all of whose pixels tell its steps; or something else."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, render_mode: str | None = None, drawn: Any = None) -> None:
        super().__init__()
        self.render_mode, self.drawn, self.steps = render_mode, drawn, 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        self.steps = 0
        return super().reset(seed=seed)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        return super().step(action)

    def render(self) -> Any:
        picture = np.full((60, 1000, 3), self.steps, np.uint8)
        return picture if self.drawn is None else self.drawn


def slower(environment: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """A wrapper: half of each action."""
    halved = gymnasium.wrappers.TransformAction(
        environment, lambda action: action / 2, environment.action_space
    )
    wrapped: gymnasium.Env[Any, Any] = halved
    return wrapped


def doubled(environment: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """A wrapper: twice the reward."""
    return gymnasium.wrappers.TransformReward(environment, lambda reward: 2 * float(reward))


def lost(environment: gymnasium.Env[Any, Any]) -> None:
    """A wrapper that forgets to return it."""


def breaking(environment: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """A wrapper that breaks."""
    raise ValueError("no such sensor")


NOTHING = 3

for made in (Goal, Zoo, Talk, Mute, Drawn):
    gymnasium.register(f"Tiny/{made.__name__}-v0", made, max_episode_steps=12)
