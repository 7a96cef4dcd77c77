"""Gymnasium environments as a world of lanes, with returns or with success."""

from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.domains.gymnasium_episode import KEYS, Episode, truth
from cgtorch.domains.gymnasium_episodes import Episodes
from cgtorch.domains.gymnasium_scaling import Scaling
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import WorldError

STEPS, RETURN, OVER, SLOT, BATCH, KEY, SOLVED, BEST = range(8)  # columns of a lane's state
HUGE = 1e38  # beyond which a return is not finite in float32
MOST_UNSOLVED = 0.45  # of the success of what has not succeeded


@dataclass(frozen=True)
class Success:
    """What an info says of success.

    Attributes:
        name: Its name in the info.
        at_last: Whether only the last step of an episode counts, and not any of them.
        mean: The mean reward of a step of random episodes.
        spread: The standard deviation of these rewards.
    """

    name: str
    at_last: bool = False
    mean: float = 0.0
    spread: float = 1.0

    def seen(self, info: Any, episode: Episode) -> bool:
        """Whether the info of an episode's step tells of success; WorldError if it is no number."""
        value = info.get(self.name, False)
        if (found := truth(value)) is not None:
            return found
        raise WorldError(
            f"the info of {episode.where} has {self.name} {value!r:.60}; name something in it that "
            "is a number, or true or false (--success), or wrap it (--wrappers)"
        )


class GymnasiumWorld(ABC):
    """An `Environment` of B starts; states begin with steps, return, and whether over."""

    frugal = True  # as steps are what searches are compared by

    def __init__(self, episodes: Episodes, seeds: Tensor, scaling: Scaling) -> None:
        """The world of starts with seeds (B,)."""
        self._episodes, self._seeds, self._scaling = episodes, seeds, scaling
        self.control_size = len(episodes.controls.fields)

    @abstractmethod
    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""

    @abstractmethod
    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""

    @abstractmethod
    def _play(self, state: Tensor, control: NDArray[Any]) -> tuple[Tensor, NDArray[Any]]:
        """The states (n, S) after controls (n, U), and percepts (n, D) that are not scaled."""

    @property
    def what(self) -> str:
        """See `Named.what`."""
        wrappers = " and ".join(self._episodes.wrappers)
        return f"environment {self._episodes.name!r}" + (f" with {wrappers}" if wrappers else "")

    @property
    def advice(self) -> str:
        """See `Named.advice`."""
        wrapper = (
            "leave out wrappers that keep statistics (such as NormalizeReward), "
            if self._episodes.wrappers
            else ""
        )
        return (
            f"{wrapper}draw all random numbers from self.np_random, which super().reset(seed=seed) "
            "seeds anew, let no clock decide anything, keep nothing in a class or module"
        )

    def begun_by(self, scenario: int) -> str:
        """See `Named.begun_by`."""
        return f"after reset(seed={int(self._seeds[scenario])})"

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
        done = control.isfinite().all(1) & (lanes.state[:, OVER] == 0)
        rows = done.nonzero()[:, 0]
        if not len(rows):
            return lanes, done
        after, seen = self._play(lanes.state[rows], control[rows].numpy())
        state = lanes.state.index_copy(0, rows, after)
        percept = lanes.percept.index_copy(0, rows, self._percepts(seen))
        return replace(lanes, state=state, percept=percept), done

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return lanes

    def _percepts(self, numbers: NDArray[Any]) -> Tensor:
        """Percepts (n, D) from numbers (n, D)."""
        seen = torch.from_numpy(numbers).double().view(-1, self.percept_size)
        return ((seen - self._scaling.centre) / self._scaling.scale).float()


class Returns(GymnasiumWorld):
    """One with rewards (`Rewarded`), in which an episode is solved from a return on."""

    def __init__(self, *common: Any, target: float) -> None:
        """For the other arguments see `GymnasiumWorld`; `target` is that return."""
        super().__init__(*common)
        self._target = target

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


class Played(GymnasiumWorld):
    """One in which every lane has its own environment.

    Further columns of a state are the episode's index, the batch in which the lane began, and the
    key of its sequence of actions.
    """

    columns = KEY + 1

    @property
    def most_lanes(self) -> int:
        """See `Bounded.most_lanes`."""
        return self._episodes.most

    def anew(self) -> Self:
        """See `Copied.anew`; DomainError if there can be no more copies."""
        made = copy(self)
        made._episodes = self._episodes.anew()
        return made

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        seeds = self._seeds[scenario].tolist()
        seen = self._episodes.begin(seeds)
        state = torch.zeros(len(seeds), self.columns, dtype=torch.float64)
        state[:, SLOT] = torch.arange(len(seeds))
        state[:, BATCH] = self._episodes.batch
        state[:, KEY] = torch.tensor(seeds, dtype=torch.float64) % KEYS
        return state, self._percepts(np.array(seen))

    def _play(self, state: Tensor, control: NDArray[Any]) -> tuple[Tensor, NDArray[Any]]:
        percepts, after = [], []
        actions = self._episodes.controls.actions(control)
        for old, own, action in zip(state.tolist(), control, actions, strict=True):
            steps, gained, _, slot, batch, key, *more = old
            episode = self._episodes.at(int(slot), int(batch), int(steps), int(key))
            seen, reward, over, info = episode.play(action, own.tobytes())
            percepts.append(seen)
            told = self._told(steps, more, reward, info, episode)
            if not abs(gained + reward) < HUGE:
                raise WorldError(
                    f"{episode.where} comes to a return of {gained + reward:g}; give rewards whose "
                    f"sums are below {HUGE:g}"
                )
            episode.over = over or self._ends(told)
            common = steps + 1, gained + reward, episode.over, slot, batch
            after.append([*common, episode.keys[-1], *told])
        return torch.tensor(after, dtype=torch.float64), np.array(percepts)

    def _told(
        self, steps: int, before: list[float], reward: float, info: Any, episode: Episode
    ) -> list[float]:
        """The further columns after a step of an episode."""
        return []

    def _ends(self, told: list[float]) -> bool:
        """Whether an episode is over with these further columns."""
        return False


class PlayedWorld(Returns, Played):
    """A world of returns in which every lane has its own environment."""


class SuccessWorld(Played):
    """A world without returns (`Episodic`), in which the info of a step tells of success.

    An episode is over with its first success, unless only its last step counts. Further columns are
    whether a lane has succeeded, and its largest reward of a step.
    """

    columns = BEST + 1

    def __init__(self, *common: Any, told: Success) -> None:
        """For the other arguments see `GymnasiumWorld`; `told` is what an info says of success."""
        super().__init__(*common)
        self._about = told

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`: 1 with success, else up to 0.45 by the largest reward so far.

        Before the first step there was none, so that a skill gains nothing by doing nothing.
        """
        state = lanes.state
        best = torch.sigmoid((state[:, BEST] - self._about.mean) / self._about.spread)
        graded = torch.where(state[:, STEPS] > 0, MOST_UNSOLVED * best, 0.0)
        return lanes, torch.where(state[:, SOLVED] > 0, 1.0, graded).to(lanes.percept)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Episodic.over`."""
        return lanes.state[:, OVER] > 0

    def _told(
        self, steps: int, before: list[float], reward: float, info: Any, episode: Episode
    ) -> list[float]:
        return [self._about.seen(info, episode), max(before[1], reward) if steps else reward]

    def _ends(self, told: list[float]) -> bool:
        return told[0] > 0 and not self._about.at_last


OWN = 3  # the column in which the environment's own state begins


class VectorSteps:
    """Steps of many episodes at once, from any states."""

    def __init__(self, environment: str) -> None:
        """Make one with that id; LookupError if there is none, or its states cannot be set."""
        import gymnasium

        environment = environment.rpartition(":")[2]  # whose module is imported by now
        known = gymnasium.registry.get(environment)  # none for a name without its version
        if known is None or known.vector_entry_point is None:
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
        count = environment.num_envs
        environment.state = _filled(state, count).T
        environment.steps = _filled(steps, count).astype(environment.steps.dtype)
        environment.prev_done = np.zeros(count, dtype=bool)
        seen, reward, terminated, truncated, _ = environment.step(_filled(action, count))
        over = terminated | truncated
        if not (np.isfinite(seen[:n]).all() and np.isfinite(reward[:n]).all()):
            raise WorldError(
                f"vectorised environment {self._id!r} showed numbers or gave rewards that are not "
                "finite; register it without vector_entry_point, to be told the seed and step"
            )
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


def _filled(rows: NDArray[Any], count: int) -> NDArray[Any]:
    """Rows (n, ...) and zeros up to `count`; numpy.pad takes ten times as long for few."""
    filled = np.zeros((count, *rows.shape[1:]), dtype=rows.dtype)
    filled[: len(rows)] = rows
    return filled


class VectorWorld(Returns):
    """A world in which one environment steps all lanes; lane states contain its states."""

    def __init__(self, vector: VectorSteps, *common: Any, target: float) -> None:
        """The world of these steps; for the other arguments see `Returns`.

        Initial states come from its `Episodes`, as vectorised environments have one seed for all.
        """
        super().__init__(*common, target=target)
        self._vector = vector

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        first = [self._episodes.first(seed) for seed in self._seeds[scenario].tolist()]
        state = torch.zeros(len(first), OWN + self._vector.size, dtype=torch.float64)
        if first:
            own = np.array([one[0] for one in first], dtype=np.float64)
            state[:, OWN:] = torch.from_numpy(own)
        return state, self._percepts(np.array([one[1] for one in first], dtype=np.float64))

    def _play(self, state: Tensor, control: NDArray[Any]) -> tuple[Tensor, NDArray[Any]]:
        actions: Any = self._episodes.controls.actions(control)
        own, steps = state[:, OWN:].numpy(), state[:, STEPS].numpy()
        after, seen, reward, over = self._vector.step(own, steps, actions)
        here = state.clone()
        here[:, OWN:] = torch.from_numpy(np.ascontiguousarray(after))
        here[:, STEPS] += 1
        here[:, RETURN] += torch.from_numpy(reward).double()
        here[:, OVER] = torch.from_numpy(over).double()
        columns = self._episodes.percepts.columns
        return here, seen if columns is None else seen[:, columns]
