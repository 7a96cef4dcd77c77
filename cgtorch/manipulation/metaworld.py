"""Meta-World: fifty tasks of a Sawyer arm with a gripper (Yu et al. 2019, version 3)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cgtorch.ground.errors import DomainError
from cgtorch.manipulation.mujoco_states import MujocoStates
from cgtorch.manipulation.simulator import Floats, Simulator

EVERY = 5  # low-level steps after which success is looked at
BEST = 10.0  # the reward of success

CW10 = (
    "hammer-v3", "push-wall-v3", "faucet-close-v3", "push-back-v3", "stick-pull-v3",
    "handle-press-side-v3", "push-v3", "shelf-place-v3", "window-close-v3", "peg-unplug-side-v3",
)  # fmt: skip
"""The tasks of Continual World (Wołczyk et al. 2021), in their order."""
MT10 = (
    "reach-v3", "push-v3", "pick-place-v3", "door-open-v3", "drawer-open-v3", "drawer-close-v3",
    "button-press-topdown-v3", "peg-insert-side-v3", "window-open-v3", "window-close-v3",
)  # fmt: skip
SETS: Mapping[str, tuple[str, ...]] = {"CW10": CW10, "CW20": (*CW10, *CW10), "MT10": MT10}


def tasks_of(name: str) -> tuple[str, ...]:
    """The tasks of a set, or the only one of that name; DomainError if there is none."""
    try:
        from metaworld.env_dict import ALL_V3_ENVIRONMENTS
    except ImportError as e:
        raise DomainError(
            "domain 'metaworld' needs package metaworld; pip install 'cgtorch[robots]'"
        ) from e
    every = tuple(ALL_V3_ENVIRONMENTS)
    known = {**SETS, "MT50": every, **{task: (task,) for task in every}}
    if name not in known:
        raise DomainError(
            f"Meta-World has no task or set {name!r}; give one of {', '.join([*SETS, 'MT50'])}, or "
            f"one of {', '.join(every)}"
        )
    return known[name]


class MetaWorldSimulator(Simulator):
    """Episodes of a task of Meta-World; seeds below 0 are goals of the benchmark, MT1."""

    patience = 120
    seen = 21  # hand, opening, two objects with quaternions, goal

    def __init__(self, task: str, horizon: int) -> None:
        """A task, whose goals are visible."""
        import mujoco
        from metaworld.env_dict import ALL_V3_ENVIRONMENTS

        super().__init__(horizon)
        self._mujoco, self._since = mujoco, 0
        self.environment: Any = ALL_V3_ENVIRONMENTS[task]()
        e = self.environment
        e._set_task_called, e._partially_observable, e.seeded_rand_vec = True, False, True
        e.max_path_length = 2**31
        self._hand = e.model.body("hand").id
        self.states = MujocoStates(e, self._reset, self._tried)

    def _reset(self, seed: int) -> Floats:
        e = self.environment
        e._freeze_rand_vec = False
        e.seed(seed)
        # It was made while the goal was hidden, and step() clips to it.
        e.__dict__.pop("sawyer_observation_space", None)
        observation: Floats = e.reset()[0]
        return observation

    def _tried(self, number: int) -> Any:
        return self.environment.step(self.probing(number))[:2]

    def perceive(self, observation: Any) -> Floats:
        """See `Simulator.perceive`; the latter half of an observation is the one before."""
        return np.concatenate([observation[:18], observation[36:]])

    def hand(self) -> Floats:
        """See `Simulator.hand`."""
        place: Floats = self.environment.data.xpos[self._hand]
        return place

    def closeness(self, observation: Any) -> float:
        """See `Simulator.closeness`."""
        return 0.0

    def move(self, action: Floats, last: bool) -> tuple[Any, float, bool] | None:
        """See `Simulator.move`; the steps between looks are those of the environment, too."""
        e = self.environment
        self._since += 1
        if not last and self._since < EVERY:
            e.set_xyz_action(action[:3])
            e.do_simulation([action[3], -action[3]], n_frames=e.frame_skip)
            self._mujoco.mj_forward(e.model, e.data)
            return None
        self._since = 0
        observation, reward, _, _, info = e.step(action)
        return observation, float(reward) / BEST, bool(info["success"])
