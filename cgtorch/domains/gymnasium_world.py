"""Gymnasium environments as a world of lanes.

A Gymnasium environment keeps its state and can only continue from it, but lanes can continue from
any earlier step. So each lane has its own environment, and its actions are recorded. A lane that
continues from an earlier step replays its episode up to there.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any
from zlib import crc32

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import WorldError

STEPS, RETURN, OVER, SLOT, BATCH, KEY = range(6)  # columns of a lane's state
_PRIME = 1_000_003
_KEYS = 2**48  # so that keys are whole numbers in float64


@dataclass(frozen=True)
class Scaling:
    """How observations become percepts: subtract an offset (D,), and divide by a scale (D,)."""

    centre: Tensor
    scale: Tensor


@dataclass
class Episode:
    """One episode in progress, which is over after at most `limit` steps.

    `keys` identify the sequence of actions that led to each step; the first is that of the start.
    """

    environment: Any
    limit: float = float("inf")
    seed: int = 0
    actions: list[Any] = field(default_factory=list)
    keys: list[int] = field(default_factory=list)

    def begin(self, seed: int) -> NDArray[np.float64]:
        """Start with a seed; returns the first observation."""
        self.seed, self.actions, self.keys = seed, [], [seed % _KEYS]
        observation: NDArray[np.float64] = self.environment.reset(seed=seed)[0]
        return observation

    def play(self, action: Any) -> tuple[NDArray[np.float64], float, bool]:
        """The observation and the reward after an action, and whether the episode is over."""
        seen, reward, terminated, truncated, _ = self.environment.step(action)
        self.actions.append(action)
        own = crc32(action.tobytes())
        self.keys.append((self.keys[-1] * _PRIME + own) % _KEYS)
        return seen, float(reward), bool(terminated or truncated or len(self.actions) >= self.limit)

    def return_to(self, step: int, key: int) -> None:
        """Continue from an earlier step; WorldError if other actions led to it."""
        if step >= len(self.keys) or self.keys[step] != key:
            raise WorldError(
                "a lane cannot continue from this step, because its Gymnasium environment has "
                "moved on; run each lane from its start"
            )
        if step < len(self.actions):
            before = self.actions[:step]
            self.begin(self.seed)
            for action in before:
                self.play(action)


class Episodes:
    """One environment per lane, all with the same id, which each batch of lanes uses again.

    `observation` and `action` are their spaces. `threshold` is the return from which the
    environment counts as solved, if it has one. `batch` counts batches of lanes; only lanes of the
    last batch can continue.
    """

    def __init__(self, environment: str) -> None:
        """Make the first environment with that id; Gymnasium's errors are passed on."""
        self._id = environment
        self._played = [self._made()]
        first = self._played[0].environment
        self.observation, self.action = first.observation_space, first.action_space
        own = first.spec.reward_threshold
        self.threshold = None if own is None else float(own)
        self.batch = 0
        self._starts: dict[int, tuple[Any, NDArray[np.float64]]] = {}

    def __reduce__(self) -> tuple[type["Episodes"], tuple[str]]:
        """Environments are not pickled: another process makes its own."""
        return Episodes, (self._id,)

    def begin(self, seeds: list[int]) -> list[NDArray[np.float64]]:
        """The first observations of a batch of episodes with these seeds."""
        self.batch += 1
        while len(self._played) < len(seeds):
            self._played.append(self._made())
        return [self._played[i].begin(seed) for i, seed in enumerate(seeds)]

    def first(self, seed: int) -> tuple[Any, NDArray[np.float64]]:
        """The environment's own state and observation at the start of an episode."""
        known = self._starts.get(seed)
        if known is None:
            observation = self._played[0].begin(seed)
            known = np.array(self._played[0].environment.unwrapped.state), observation
            self._starts[seed] = known
        return known

    def at(self, slot: int, batch: int, step: int, key: int) -> Episode:
        """An episode at a step; see `Episode.return_to`."""
        if batch != self.batch:
            raise WorldError(
                "a lane cannot go on after other lanes have begun in the same Gymnasium "
                "environment; run one batch after the other"
            )
        found = self._played[slot]
        found.return_to(step, key)
        return found

    def random_observations(self, count: int, most: int) -> NDArray[np.float64]:
        """(N, D) observations of `count` episodes with random actions, at most `most` in each."""
        episode, seen = self._played[0], []
        self.action.seed(0)
        for seed in range(count):
            seen.append(episode.begin(seed))
            for _ in range(most):
                action = np.asarray(self.action.sample())
                observation, _, over = episode.play(action)
                seen.append(observation)
                if over:
                    break
        return np.stack(seen)

    def _made(self) -> Episode:
        """A new environment, without the wrappers that only limit steps and check their order."""
        import gymnasium
        from gymnasium.wrappers import OrderEnforcing, TimeLimit

        made: Any = gymnasium.make(self._id, disable_env_checker=True)
        limit = getattr(made.spec, "max_episode_steps", None) or float("inf")
        while type(made) in (OrderEnforcing, TimeLimit):
            made = made.env
        return Episode(made, limit)


class GymnasiumWorld(ABC):
    """A rewarded `Environment` of B starts; states begin with steps, return, and whether over."""

    def __init__(
        self, episodes: Episodes, seeds: Tensor, scaling: Scaling, control_size: int, target: float
    ) -> None:
        """The world of starts with seeds (B,); an episode is solved from the return `target`."""
        self._episodes, self._seeds, self._scaling = episodes, seeds, scaling
        self.control_size, self._target = control_size, target

    @abstractmethod
    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""

    @abstractmethod
    def _play(self, state: Tensor, actions: NDArray[Any]) -> tuple[Tensor, NDArray[Any]]:
        """The states (n, S) after actions (n, ...), and observations (n, D)."""

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self._seeds)

    @property
    def percept_size(self) -> int:
        """D."""
        return len(self._scaling.centre)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`; a finished episode does not change any more."""
        done = control.isfinite().all(1) & ~self.over(lanes)
        rows = done.nonzero()[:, 0]
        if not len(rows):
            return lanes, done
        after, seen = self._play(lanes.state[rows], self._actions(control[rows]))
        state = lanes.state.index_copy(0, rows, after)
        percept = lanes.percept.index_copy(0, rows, self._percepts(seen))
        return replace(lanes, state=state, percept=percept), done

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`: whether a finished episode reached the target return."""
        solved = self.over(lanes) & (lanes.state[:, RETURN] >= self._target)
        return lanes, solved.to(lanes.percept)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return lanes.state[:, OVER] > 0

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return lanes.state[:, RETURN]

    def _percepts(self, observations: NDArray[np.floating[Any]]) -> Tensor:
        """Percepts (n, D) from observations (n, D)."""
        seen = torch.from_numpy(observations).double().view(-1, self.percept_size)
        return ((seen - self._scaling.centre) / self._scaling.scale).float()

    def _actions(self, control: Tensor) -> NDArray[Any]:
        """Actions (n, ...) in the form that Gymnasium expects."""
        space = self._episodes.action
        if not hasattr(space, "low"):
            return control.argmax(1).numpy() + int(getattr(space, "start", 0))
        within: NDArray[Any] = control.numpy().clip(space.low, space.high).astype(space.dtype)
        return within


class PlayedWorld(GymnasiumWorld):
    """A world in which every lane has its own environment.

    Further columns of a state are the environment's index, the batch in which the lane began, and
    the key of its sequence of actions.
    """

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        seeds = self._seeds[scenario].tolist()
        observations = self._episodes.begin(seeds)
        state = torch.zeros(len(seeds), 6, dtype=torch.float64)
        state[:, SLOT] = torch.arange(len(seeds))
        state[:, BATCH] = self._episodes.batch
        state[:, KEY] = torch.tensor(seeds, dtype=torch.float64) % _KEYS
        return state, self._percepts(np.array(observations))

    def _play(self, state: Tensor, actions: NDArray[Any]) -> tuple[Tensor, NDArray[Any]]:
        observations, after = [], []
        for old, action in zip(state.tolist(), actions, strict=True):
            steps, gained, _, slot, batch, key = old
            episode = self._episodes.at(int(slot), int(batch), int(steps), int(key))
            seen, reward, over = episode.play(action)
            observations.append(seen)
            after.append([steps + 1, gained + reward, over, slot, batch, episode.keys[-1]])
        return torch.tensor(after, dtype=torch.float64), np.array(observations)


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
