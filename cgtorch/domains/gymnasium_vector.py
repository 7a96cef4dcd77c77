"""Gymnasium's own vectorised environments as a world: one call for all lanes.

It needs an environment whose states are an array that can be set, such as CartPole's.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.domains.gymnasium_world import OVER, RETURN, STEPS, GymnasiumWorld

OWN = 3  # the column in which the environment's own state begins


class VectorSteps:
    """Steps of many episodes at once, from any states."""

    def __init__(self, environment: str) -> None:
        """Make one with that id; LookupError if there is none, or its states cannot be set."""
        import gymnasium

        if gymnasium.spec(environment).vector_entry_point is None:
            raise LookupError(f"{environment} has no vectorised environment of its own")
        self._id, self._made = environment, dict[int, Any]()
        first = self._of_size(1)
        state = getattr(first, "state", None)
        if not isinstance(state, np.ndarray) or state.ndim != 2 or not hasattr(first, "prev_done"):
            raise LookupError(f"states of {environment} cannot be set")
        self.size = state.shape[0]

    def step(
        self, state: NDArray[Any], steps: NDArray[Any], action: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
        """One step of n episodes from states (n, S) after `steps` (n,), with actions (n,).

        Returned are states (n, S), observations (n, D), rewards (n,), and (n,) bool, which are
        over.
        """
        n = len(state)
        environment = self._of_size(1 << (n - 1).bit_length())
        more = environment.num_envs - n
        environment.state = np.pad(state, ((0, more), (0, 0))).T
        environment.steps = np.pad(steps, (0, more)).astype(environment.steps.dtype)
        environment.prev_done = np.zeros(environment.num_envs, dtype=bool)
        seen, reward, terminated, truncated, _ = environment.step(np.pad(action, (0, more)))
        over = terminated | truncated
        return environment.state.T[:n], seen[:n], reward[:n], over[:n]

    def _of_size(self, count: int) -> Any:
        """An environment of at least `count` episodes. Sizes are powers of two, so few are made."""
        import gymnasium

        if count not in self._made:
            mode = gymnasium.VectorizeMode.VECTOR_ENTRY_POINT
            made = gymnasium.make_vec(self._id, num_envs=count, vectorization_mode=mode).unwrapped
            made.reset(seed=0)
            self._made[count] = made
        return self._made[count]


class VectorWorld(GymnasiumWorld):
    """A world in which one environment steps all lanes; lane states contain its states."""

    def __init__(self, vector: VectorSteps, *common: Any) -> None:
        """The world of these steps; for the other arguments see `GymnasiumWorld`.

        Initial states come from its `Episodes`, as vectorised environments have one seed for all.
        """
        super().__init__(*common)
        self._vector = vector

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        first = [self._episodes.first(seed) for seed in self._seeds[scenario].tolist()]
        state = torch.zeros(len(first), OWN + self._vector.size, dtype=torch.float64)
        if first:
            own = np.array([one[0] for one in first], dtype=np.float64)
            state[:, OWN:] = torch.from_numpy(own)
        return state, self._percepts(np.array([one[1] for one in first], dtype=np.float64))

    def _play(self, state: Tensor, actions: NDArray[Any]) -> tuple[Tensor, NDArray[Any]]:
        own, steps = state[:, OWN:].numpy(), state[:, STEPS].numpy()
        after, seen, reward, over = self._vector.step(own, steps, actions)
        here = state.clone()
        here[:, OWN:] = torch.from_numpy(np.ascontiguousarray(after))
        here[:, STEPS] += 1
        here[:, RETURN] += torch.from_numpy(reward).double()
        here[:, OVER] = torch.from_numpy(over).double()
        return here, seen
