"""Episodes of linear policies in a Gymnasium environment, and statistics of what they see."""

from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Numbers: TypeAlias = NDArray[np.float64]
LEAST = 1e-8  # standard deviation of a number that varies
FRESH_SEED = 1000  # of the generator of starts on which policies are tested
FIRST_LOOK, LOOKS = 20, 10  # episodes of a test on the way, and their number


@dataclass
class Seen:
    """The number of observations so far, their means (D,), and sums of squared deviations (D,)."""

    mean: Numbers
    squares: Numbers
    count: int = 0

    @classmethod
    def nothing(cls, size: int) -> "Seen":
        """Before the first observation of `size` numbers."""
        return cls(np.zeros(size), np.zeros(size))

    def add(self, rows: Numbers) -> None:
        """Further observations (n, D) (Chan et al., The American Statistician 37, 1983)."""
        mean = rows.mean(0)
        self.join(Seen(mean, ((rows - mean) ** 2).sum(0), len(rows)))

    def join(self, other: "Seen") -> None:
        """All that another one has seen."""
        gap, total = other.mean - self.mean, self.count + other.count
        self.squares = self.squares + other.squares + gap**2 * self.count * other.count / total
        self.mean, self.count = self.mean + gap * other.count / total, total

    @property
    def deviation(self) -> Numbers:
        """(D,), inf for numbers that do not vary, which policies then do not see."""
        if self.count < 2:
            return np.ones_like(self.mean)
        found = np.sqrt(self.squares / (self.count - 1))
        return np.where(found < LEAST, np.inf, found)


@dataclass(frozen=True)
class Linear:
    """A policy: controls are `weights` (U, D) times the normalised observation, plus `bias`."""

    weights: Numbers
    bias: Numbers | float = 0.0
    mean: Numbers | float = 0.0
    deviation: Numbers | float = 1.0

    def plain(self) -> tuple[Numbers, Numbers]:
        """Weights (U, D) and bias (U,) for observations as they are."""
        weights = self.weights / self.deviation
        return weights, self.bias - weights @ np.broadcast_to(self.mean, weights.shape[1])


@dataclass
class Trial:
    """A search of a peer: what it plays, what it has cost, and how good its policies were.

    Attributes:
        name: The environment.
        seed: Of the search.
        limit: Steps after which no update begins.
        generator: Where its random numbers come from.
        steps: Steps so far, without tests.
        episodes: Episodes so far, without tests.
        curve: Steps, and the mean return of `FIRST_LOOK` fresh episodes.
    """

    name: str
    seed: int
    limit: int
    steps: int = 0
    episodes: int = 0
    curve: list[tuple[int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.generator = np.random.default_rng(self.seed)
        self.environment, self.longest = made(self.name)
        self.inputs = self.environment.observation_space.shape[0]
        self.outputs = self.environment.action_space.shape[0]

    @property
    def open(self) -> bool:
        """Whether another update may begin."""
        return self.steps < self.limit

    def play(self, policy: Linear, toll: float = 0.0, seen: Seen | None = None) -> float:
        """The return of an episode from a start of its own, less a toll for each step.

        What it shows is added to `seen`.
        """
        start = int(self.generator.integers(2**31))
        gained, length, rows = self._played(policy, start, seen is not None)
        if seen is not None:
            seen.add(np.array(rows))
        self.steps, self.episodes = self.steps + length, self.episodes + 1
        return gained - toll * length

    def look(self, policy: Linear) -> None:
        """Test the policy if a tenth of the steps has been made since the last test."""
        if self.steps * LOOKS >= self.limit * (len(self.curve) + 1):
            self.curve.append((self.steps, fmean(self.tested(policy, FIRST_LOOK))))

    def tested(self, policy: Linear, count: int) -> list[float]:
        """The returns of fresh episodes, which are not counted."""
        starts = np.random.default_rng(FRESH_SEED).integers(2**31, size=count).tolist()
        return [self._played(policy, start, False)[0] for start in starts]

    def _played(self, policy: Linear, start: int, kept: bool) -> tuple[float, int, list[Any]]:
        """The return of an episode, its length, and if they are kept, its observations."""
        environment, space = self.environment, self.environment.action_space
        weights, bias = policy.plain()
        seen, _ = environment.reset(seed=start)
        gained, rows, length, over = 0.0, list[Any](), 0, False
        while not over:
            if kept:
                rows.append(seen)
            action = np.clip(weights @ seen + bias, space.low, space.high).astype(space.dtype)
            seen, reward, fell, _, _ = environment.step(action)
            gained, length = gained + float(reward), length + 1
            over = fell or length >= self.longest
        return gained, length, rows


def made(name: str) -> tuple[Any, float]:
    """An environment without wrappers, whose limit of steps is returned beside it."""
    import gymnasium
    from gymnasium.wrappers import OrderEnforcing, TimeLimit

    environment: Any = gymnasium.make(name, disable_env_checker=True)
    assert environment.spec is not None  # noqa: S101
    longest = float(environment.spec.max_episode_steps or "inf")
    while type(environment) in (OrderEnforcing, TimeLimit):
        environment = environment.env
    return environment, longest
