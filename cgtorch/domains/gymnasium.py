"""Any Gymnasium environment with vector observations as a domain.

Scenarios are seeds of `reset`. A percept is the observation, scaled to numbers around 1. A control
is an action, or one number for each discrete action, of which the largest is taken. Skills are
evolved in the environment itself, and returns are those of Gymnasium.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain, Specialists
from cgtorch.domains.files import Files
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import (
    Episodes,
    GymnasiumWorld,
    PlayedWorld,
    Scaling,
    VectorSteps,
    VectorWorld,
)
from cgtorch.domains.pictures import Pictures
from cgtorch.ground.environment import ScenarioBatch
from cgtorch.ground.errors import DomainError
from cgtorch.ground.fields import Field
from cgtorch.ground.files import read_json, write_json

FILE = "gymnasium.json"
LOOKS = 20  # random episodes that tell the scale of numbers without bounds
STEPS = 200  # of each at most


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """Initial states of episodes, given by the `seed` (B,) long of `reset`."""

    seed: Tensor


class EpisodePictures(Pictures["Gymnasium"]):
    """Words for episodes."""

    solved: ClassVar[tuple[str, str]] = ("solved", "Episodes solved")

    def about(self) -> list[tuple[str, str]]:
        """See `Pictures.about`."""
        return [
            ("Environment", self.domain.settings.environment),
            ("Solved from a return of", f"{self.domain.target_return:g}"),
        ]


class ScalingFiles(Files["Gymnasium"]):
    """The scaling of observations, and the return that counts as solved."""

    def write(self, folder: Path) -> None:
        """See `Files.write`."""
        scaling = self.domain.scaling
        about = {"centre": scaling.centre.tolist(), "scale": scaling.scale.tolist()}
        write_json(folder / FILE, {**about, "target_return": self.domain.target_return})

    @classmethod
    def read(cls, kind: type["Gymnasium"], settings: Any, folder: Path) -> "Gymnasium":
        """See `Files.read`."""
        data = read_json(folder / FILE)
        try:
            scaling = Scaling(
                *(torch.tensor(data[n], dtype=torch.float64) for n in ("centre", "scale"))
            )
            target = float(data["target_return"])
            if not (scaling.scale > 0).all() or not scaling.centre.isfinite().all():
                raise ValueError("a scale is not above 0")
        except (KeyError, TypeError, ValueError, RuntimeError) as e:
            raise DomainError(f"{str(folder / FILE)!r} is damaged ({e}); restore the file") from e
        made = kind(settings, scaling, target)
        if scaling.scale.shape != scaling.centre.shape or len(scaling.scale) != len(made.percept):
            raise DomainError(f"{str(folder / FILE)!r} is of another environment; restore the file")
        return made

    def made_with(self) -> Mapping[str, str]:
        """See `Files.made_with`."""
        import gymnasium

        return {"gymnasium": gymnasium.__version__}


class Gymnasium(Domain[Starts]):
    """A Gymnasium environment, such as gymnasium:CartPole-v1."""

    settings: GymnasiumSettings
    settings_type = GymnasiumSettings
    models = None
    kinds = ("starts",)
    specialists = Specialists(group=8, widest=32, stall=100)
    pictures = EpisodePictures
    files = ScalingFiles

    def __init__(
        self,
        settings: GymnasiumSettings | None = None,
        scaling: Scaling | None = None,
        target: float | None = None,
    ) -> None:
        """The environment of the settings.

        By default, the scaling of observations is measured in random episodes, and the return from
        which an episode is solved is that of the settings. DomainError if Gymnasium is not
        installed, has no such environment, or its spaces are not supported.
        """
        super().__init__(settings)
        name = self.settings.environment
        self.episodes = _episodes(name)
        self.vector: VectorSteps | None = None
        with suppress(LookupError):  # it has no vectorised environment that suits lanes
            self.vector = VectorSteps(name)
        self.percept = _percept(self.episodes.observation, name)
        self.control = _control(self.episodes.action, name)
        self.target_return = self._target() if target is None else target
        self.scaling = scaling or _explored(self.episodes)

    def draw(self, kind: str, count: int, generator: Generator) -> Starts:
        """See `Domain.draw`."""
        return Starts(torch.randint(2**31, (count,), generator=generator))

    def world(self, scenarios: Starts) -> GymnasiumWorld:
        """See `Domain.world`."""
        size, seeds = len(self.control), scenarios.seed
        common = self.episodes, seeds, self.scaling, size, self.target_return
        return VectorWorld(self.vector, *common) if self.vector else PlayedWorld(*common)

    def _target(self) -> float:
        given, own = self.settings.target_return, self.episodes.threshold
        if given != float("inf"):
            return given
        if own is None:
            raise DomainError(
                f"environment {self.settings.environment!r} names no return from which "
                "it counts as solved; give one as target (--target)"
            )
        return own


def _episodes(environment: str) -> Episodes:
    """The environment with this id; DomainError if Gymnasium cannot make it."""
    try:
        import gymnasium
    except ImportError as e:
        raise DomainError(
            "domain 'gymnasium' needs package gymnasium; pip install 'cgtorch[gymnasium]'"
        ) from e
    try:
        return Episodes(environment)
    except (gymnasium.error.Error, ImportError, TypeError, ValueError) as e:
        reason = " ".join(str(e).split())[:200]
        raise DomainError(
            f"Gymnasium cannot make environment {environment!r} ({reason}); is it spelt right and "
            "its package installed?"
        ) from e


def _percept(space: Any, environment: str) -> tuple[Field, ...]:
    """The fields of an observation."""
    from gymnasium.spaces import Box

    if not isinstance(space, Box) or len(space.shape) != 1:
        raise DomainError(
            f"environment {environment!r} has observations {space}; only vectors of numbers can be "
            "percepts"
        )
    return tuple(Field(f"observation {i + 1}") for i in range(space.shape[0]))


def _control(space: Any, environment: str) -> tuple[Field, ...]:
    """The fields of an action, or one field for each discrete action."""
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete):
        count = int(space.n)
        return tuple(Field(f"preference for action {i + 1}", low=-1, high=1) for i in range(count))
    if isinstance(space, Box) and len(space.shape) == 1:
        bounds = zip(space.low.tolist(), space.high.tolist(), strict=True)
        return tuple(Field(f"action {i + 1}", low=a, high=b) for i, (a, b) in enumerate(bounds))
    raise DomainError(
        f"environment {environment!r} has actions {space}; only vectors of numbers and discrete "
        "ones can be controls"
    )


def _explored(episodes: Episodes) -> Scaling:
    """The scaling of observations, measured in random episodes; constant numbers are not scaled.

    Bounds can be far too wide for scaling: divided by the bounds of a velocity, all values would be
    close to 0.
    """
    seen = torch.from_numpy(episodes.random_observations(LOOKS, STEPS)).double()
    spread = seen.std(0)
    return Scaling(seen.mean(0), torch.where(spread > 1e-6, spread, 1.0))
