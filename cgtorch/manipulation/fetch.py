"""Gymnasium-Robotics' four tasks of a Fetch arm (Plappert et al. 2018)."""

from typing import Any

import numpy as np

from cgtorch.ground.errors import DomainError
from cgtorch.manipulation.mujoco_states import MujocoStates
from cgtorch.manipulation.simulator import Floats, Simulator

PUSH, SLIDE = "FetchPush-v4", "FetchSlide-v4"
TASKS = ("FetchReach-v4", PUSH, "FetchPickAndPlace-v4", SLIDE)


def tasks_of(name: str) -> tuple[str, ...]:
    """The task of that name; DomainError if there is none."""
    try:
        import gymnasium_robotics  # noqa: F401
    except ImportError as e:
        raise DomainError(
            "domain 'gymnasium-robotics' needs package gymnasium-robotics; pip install "
            "'cgtorch[robots]'"
        ) from e
    if name not in TASKS:
        raise DomainError(
            f"domain 'gymnasium-robotics' has no task {name!r}; give one of {', '.join(TASKS)}"
        )
    return (name,)


class FetchSimulator(Simulator):
    """Episodes of a Fetch task, which is solved if it is at the last step."""

    seen = 10  # hand, object, goal, opening
    at_the_end = True
    gain = 8.0

    def __init__(self, task: str, horizon: int) -> None:
        """The task."""
        import gymnasium
        import gymnasium_robotics

        super().__init__(horizon)
        gymnasium.register_envs(gymnasium_robotics)
        self.environment: Any = gymnasium.make(task).unwrapped
        self.states = MujocoStates(self.environment, self._reset, self._tried)

    def _reset(self, seed: int) -> Any:
        return self.environment.reset(seed=seed)[0]

    def _tried(self, number: int) -> Any:
        return self.environment.step(self.probing(number))[:2]

    def perceive(self, observation: Any) -> Floats:
        """See `Simulator.perceive`; without an object, the hand is in its place."""
        seen, goal = observation["observation"], observation["desired_goal"]
        thing = seen[3:6] if len(seen) > 10 else seen[:3]
        opening = seen[9] + seen[10] if len(seen) > 10 else 0.0
        return np.array([*seen[:3], *thing, *goal, opening])

    def hand(self) -> Floats:
        """See `Simulator.hand`."""
        place: Floats = self.environment._utils.get_site_xpos(
            self.environment.model, self.environment.data, "robot0:grip"
        )
        return place

    def show(self) -> None:
        """See `Simulator.show`: the goal, whose place the next step computes again."""
        self.environment.data.site("target0").xpos[:] = self.environment.goal

    def closeness(self, observation: Any) -> float:
        """See `Simulator.closeness`."""
        there, wanted = observation["achieved_goal"], observation["desired_goal"]
        return float(np.exp(-5 * np.linalg.norm(there - wanted)))

    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool]:
        """See `Simulator.move`."""
        action = np.array([*action[:3], -action[3]], dtype=np.float32)  # a positive number opens
        observation, *_, info = self.environment.step(action)
        return observation, self.closeness(observation), bool(info["is_success"])
