"""Γ of a domain with rewards, what steps give there, and how episodes are imagined from it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any, Generic, Self, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch.domains.exploration import random_controls
from cgtorch.domains.gaussian_process import GaussianProcess
from cgtorch.domains.learned_reward import LearnedReward
from cgtorch.domains.models import HasFields
from cgtorch.domains.percept_limits import Limits
from cgtorch.domains.rewarded_model import CuriousModel, Imagined, Reward, RewardedModel
from cgtorch.ground.errors import DomainError, RunError, SettingsError
from cgtorch.ground.fields import columns_of, within_bounds
from cgtorch.improvement.played import Steps

MOST_NUMBERS = 30
"""Numbers of a percept from which Γ can be learned: it has a length scale for each of them."""
VAGUE = 0.3
"""The noise of Γ, as a share of the usual change, from which percepts hardly tell what comes."""

D = TypeVar("D", bound=HasFields)
"""The domain of models."""


class RewardedModels(Generic[D]):
    """Γ of a domain with rewards, which can name a subclass as `Domain.models` to say more.

    Attributes:
        domain: The domain.
        reward: What steps give and which end an episode, a `Reward` of percepts and effective
            controls; None if that is learned.
        most_steps: Steps after which the world ends an episode by itself; inf if it never does.
        graded: Whether rewards tell of any state how close it is to success, so that returns are in
            [0, 1]. Then what seems best so far is always played next, and where Γ knows nothing, an
            episode keeps its return.
        looks: First percepts of episodes that are looked at, without a step.
        changes: Chances of another control in each step, of each of the first episodes.
    """

    reward: Reward | None = None
    most_steps: float = inf
    graded: bool = False
    looks: int = 500
    changes: Sequence[float] = (1.0, 0.25, 0.06, 1.0)

    def __init__(self, domain: D) -> None:
        """The models of a domain; SettingsError or DomainError if Γ cannot be learned of it."""
        self.domain = domain
        if (size := len(domain.percept)) > MOST_NUMBERS:
            raise SettingsError(
                f"percepts have {size} numbers, and Γ with rewards is learned from at most "
                f"{MOST_NUMBERS}; choose some of them, or evolve in the world itself: models "
                "'none' (--models none)"
            )
        if angles := columns_of(domain.percept, "angle"):
            raise DomainError(
                f"percept {domain.percept[angles[0]].name!r} is an angle, which jumps after a "
                "turn; perceive its sine and cosine to learn Γ with rewards"
            )

    def effect(self, control: Tensor) -> Tensor:
        """What counts of controls (n, U), by default what is within the bounds of their fields."""
        return within_bounds(control, self.domain.control)

    def limits(self, percepts: Tensor) -> Limits:
        """Which percepts are possible, judged by those of all steps (n, D)."""
        return Limits.found(self.domain.percept, percepts)

    def random_control(self, percept: Tensor, generator: Generator) -> Tensor:
        """(1, U) a random control at a percept (1, D), by default uniform within bounds.

        DomainError if one of its numbers has none.
        """
        return random_controls(self.domain.control, 1, generator)

    def fit_gamma(self, steps: Steps, free: Tensor | None) -> GaussianProcess:
        """Γ fitted to steps; its parameters continue from those that are given."""
        return GaussianProcess(steps.percept, steps.control, steps.after, free)

    def fit_reward(self, steps: Steps, free: Tensor | None, starts: Tensor) -> Reward:
        """Rewards and ends fitted to steps in episodes that begin at `starts` (b, D)."""
        return LearnedReward(steps, free, starts)

    def learned(self, starts: Tensor, steps: Steps) -> "Known":
        """What steps tell, and first percepts (n, D); DataError if there are no steps."""
        return Known.fitted(self, starts, steps)

    def recalled(self, tensors: Mapping[str, Tensor]) -> "Known":
        """What is known, from `Known.tensors`; RunError if they are damaged."""
        try:
            steps = Steps(*(tensors[name] for name in STEPS))
            free = tensors["gamma"], tensors["reward"]
            begun = [x if len(x) else None for x in free]
            made = Known.fitted(self, tensors["starts"], steps, *begun)
            return replace(made, offered=int(tensors["offered"]))
        except (KeyError, RuntimeError, ValueError, IndexError) as e:
            raise RunError(f"the stored steps in the world are damaged ({e}); remove them") from e


STEPS = "percept", "control", "after", "gained", "ended"
"""The names of the columns of `Steps` in files."""
NAMES = *STEPS, "starts", "gamma", "reward", "offered"
"""The names of all tensors there."""


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Known:
    """What is known of a world with rewards.

    Attributes:
        models: Those of its domain.
        starts: (b, D) percepts with which episodes begin.
        steps: All that happened.
        gamma: What happens, and how sure that is.
        reward: What steps give.
        limits: Which percepts are possible.
        begun: The parameters with which the fits of Γ and of rewards began, None for the usual.
        offered: Skills that were good in the world, and not good enough on fresh episodes.
    """

    models: RewardedModels[Any]
    starts: Tensor
    steps: Steps
    gamma: GaussianProcess
    reward: Reward
    limits: Limits
    begun: tuple[Tensor | None, Tensor | None]
    offered: int = 0

    @classmethod
    def fitted(
        cls,
        models: RewardedModels[Any],
        starts: Tensor,
        steps: Steps,
        gamma: Tensor | None = None,
        reward: Tensor | None = None,
    ) -> Self:
        """All models fitted to steps; their parameters continue from those that are given."""
        steps = replace(steps, control=models.effect(steps.control))
        limits = models.limits(torch.cat([steps.percept, steps.after]))
        tell = limits.inside(steps.after)
        some = steps.rows(tell) if bool(tell.any()) else steps
        found = models.fit_gamma(some, gamma)
        given = models.reward or models.fit_reward(steps, reward, starts)
        return cls(models, starts, steps, found, given, limits, (gamma, reward))

    def after(self, starts: Tensor, steps: Steps) -> "Known":
        """The same with further first percepts (n, D) and steps."""
        effective = replace(steps, control=self.models.effect(steps.control))
        every = Steps.joined([self.steps, effective])
        free = self.gamma.free, getattr(self.reward, "free", None)
        made = Known.fitted(self.models, torch.cat([self.starts, starts]), every, *free)
        return replace(made, offered=self.offered)

    def most(self, steps: int) -> float:
        """The return of an episode whose every step gives what the best one has given so far.

        Learned rewards promise hardly more than that. Given rewards are known everywhere: inf. So
        it is of graded ones, which are small far from success.
        """
        if self.models.reward is not None or self.models.graded:
            return inf
        best, ends = float(self.steps.reward.max()), bool(self.steps.ended.any())
        fewest = 1 if ends else min(steps, self.models.most_steps)
        return best * (fewest if best < 0 else min(steps, self.models.most_steps))

    def refused(self) -> "Known":
        """The same after a skill that was offered was not good enough."""
        return replace(self, offered=self.offered + 1)

    def world(self, count: int, most_steps: int, generator: Generator) -> RewardedModel:
        """Γ as a world of so many starts, whose episodes are not longer than the world's."""
        return self._world(RewardedModel, count, most_steps, generator)

    def curious(self, count: int, most_steps: int, generator: Generator) -> RewardedModel:
        """Γ as such a world that rewards coming to where it knows little, up to 1 a step."""
        doubt = getattr(self.reward, "doubt", None)
        kind = partial(CuriousModel, doubt=doubt)
        return self._world(kind, count, most_steps, generator)

    def begun_at(self, start: Tensor, count: int, most_steps: int, generator: Generator) -> Any:
        """`world`, in which all episodes begin with the same percept (1, D)."""
        return replace(self, starts=start).world(count, most_steps, generator)

    def _world(self, kind: Callable[..., Any], count: int, most: int, generator: Generator) -> Any:
        steps = int(min(most, self.models.most_steps))
        starts = Imagined.drawn(self.starts.double(), count, generator)
        least = 0.0 if self.models.graded else float(self.steps.reward.min())
        ways = self.models.effect, self.limits.valid
        return kind(starts, self.gamma, self.reward, steps, least, *ways)

    @property
    def noise(self) -> float:
        """What Γ cannot explain, as a share of the usual change."""
        return float(self.gamma.kernel.noise.sqrt())

    def summary(self) -> str:
        """A line on what was learned."""
        text = f"Γ of {len(self.steps)} steps, noise {self.noise:.2%} of the changes"
        if self.models.reward is None:
            text += f", rewards and {int(self.steps.ended.sum())} ends learned from them"
        if self.noise > VAGUE:
            text += (
                "; percepts hardly tell what comes next, so skills may be good in Γ only: give "
                "percepts that do, such as velocities, or evolve in the world (--models none)"
            )
        return text

    def tensors(self) -> dict[str, Tensor]:
        """The tensors that `RewardedModels.recalled` reads."""
        nothing = torch.empty(0, dtype=torch.float64)
        gamma, reward = (nothing if free is None else free for free in self.begun)
        columns = dict(zip(STEPS, vars(self.steps).values(), strict=True))
        about = {"starts": self.starts, "gamma": gamma, "reward": reward}
        return {**columns, **about, "offered": torch.tensor(self.offered)}
