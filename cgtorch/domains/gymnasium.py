"""Any Gymnasium environment as a domain.

Scenarios are seeds of `reset`. A percept has the numbers of an observation, scaled to numbers
around 1. A control has the numbers of an action, and one number for each discrete choice, of which
the largest is taken. Skills are evolved in the environment itself. Returns are those of Gymnasium,
or there are none, and the info of a step tells of success.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import torch
from numpy.typing import NDArray
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain, Specialists
from cgtorch.domains.files import Files
from cgtorch.domains.film import Film
from cgtorch.domains.gymnasium_episodes import Episodes, Explored
from cgtorch.domains.gymnasium_film import MODE
from cgtorch.domains.gymnasium_limits import bounds_of_percepts
from cgtorch.domains.gymnasium_models import GymnasiumModels
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import (
    GymnasiumWorld,
    PlayedWorld,
    Scaling,
    Success,
    SuccessWorld,
    VectorSteps,
    VectorWorld,
)
from cgtorch.domains.pictures import Pictures
from cgtorch.graphs import ActionSet, Skill, Test, reward_actions
from cgtorch.ground.environment import ScenarioBatch
from cgtorch.ground.errors import DomainError
from cgtorch.ground.files import read_json, write_json

FILE = "gymnasium.json"
LOOKS = 20  # random episodes that tell the scale of numbers without bounds
STEPS = 200  # of each at most
FEW_LOOKS, FEW_STEPS = 5, 20  # where each step counts
EVEN = 1e-9  # the largest spread of numbers that do not vary, as a share of the largest
SINGLE = 1e-6  # the smallest difference of rewards that returns still tell, as a share
FAMILIAR = ("is_success", "success")
"""Names in the info of a step that tell of success in many environments."""


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """Initial states of episodes, given by the `seed` (B,) long of `reset`."""

    seed: Tensor


@dataclass(frozen=True)
class Known:
    """What random episodes tell before a training, which the run keeps.

    Attributes:
        scaling: The scaling of observations.
        success: What an info says of success; None if returns count.
        target: The return from which an episode is solved, if returns count.
        remark: A sentence about what was found; "" if there is nothing to say.
    """

    scaling: Scaling
    success: Success | None = None
    target: float = 0.0
    remark: str = ""


class EpisodePictures(Pictures["Gymnasium"]):
    """Words for episodes, and films."""

    solved: ClassVar[tuple[str, str]] = ("solved", "Episodes solved")

    def about(self) -> list[tuple[str, str]]:
        """See `Pictures.about`."""
        success = self.domain.known.success
        solved = ("Solved from a return of", f"{self.domain.target_return:g}")
        if success is not None:
            when = "at the last step of an episode" if success.at_last else "at any step"
            solved = ("Solved by", f"{success.name} in the info, {when}")
        remarks = [("Remark", remark) for remark in self.remarks()]
        return [("Environment", self.domain.settings.environment), solved, *remarks]

    def remarks(self) -> list[str]:
        """See `Pictures.remarks`."""
        found, left_out = self.domain.known.remark, self.domain.episodes.percepts.left_out
        unasked = left_out and not self.domain.settings.percepts
        each = " and ".join(f"{name} (it has {what})" for name, what in left_out.items())
        lacks = f"Percepts lack {each}."
        copies, why = self.domain.episodes.most, self.domain.episodes.lacking
        few = f"Only {copies} at once of the environment could be made, which is slow: {why}"
        told = (found, found), (unasked, lacks), (why, few)
        return [remark for so, remark in told if so]

    def film(self, skill: Skill, scenarios: Any, width: int) -> Film | None:
        """See `Pictures.film`: what the environment itself draws."""
        domain, settings = self.domain, self.domain.settings
        if MODE not in domain.episodes.modes:
            return None
        keywords = {**settings.keywords, "render_mode": MODE}
        drawing = type(domain)(replace(settings, env=keywords), domain.known)
        filmed = drawing.episodes.film(width)
        return filmed.reel.play(skill, drawing.world(scenarios[:1]))


class KnownFiles(Files["Gymnasium"]):
    """What random episodes told, as `Known`."""

    def write(self, folder: Path) -> None:
        """See `Files.write`."""
        known = self.domain.known
        scaling, success = known.scaling, known.success
        about = {"centre": scaling.centre.tolist(), "scale": scaling.scale.tolist()}
        solved = {"success": vars(success)} if success else {"target_return": known.target}
        write_json(folder / FILE, {**about, **solved, "remark": known.remark})

    @classmethod
    def read(cls, kind: type["Gymnasium"], settings: Any, folder: Path) -> "Gymnasium":
        """See `Files.read`."""
        data = read_json(folder / FILE)
        try:
            scaling = Scaling(
                *(torch.tensor(data[n], dtype=torch.float64) for n in ("centre", "scale"))
            )
            success = _success(data["success"]) if "success" in data else None
            target = 0.0 if success else float(data["target_return"])
            if not (scaling.scale > 0).all() or not scaling.centre.isfinite().all():
                raise ValueError("a scale is not above 0")
        except (KeyError, TypeError, ValueError, RuntimeError) as e:
            raise DomainError(f"{str(folder / FILE)!r} is damaged ({e}); restore the file") from e
        made = kind(settings, Known(scaling, success, target, str(data.get("remark", ""))))
        if scaling.scale.shape != scaling.centre.shape or len(scaling.scale) != len(made.percept):
            raise DomainError(f"{str(folder / FILE)!r} is of another environment; restore the file")
        return made

    def made_with(self) -> Mapping[str, str]:
        """See `Files.made_with`."""
        import gymnasium

        return {"gymnasium": gymnasium.__version__}

    def options(self, folder: Path) -> Mapping[str, str]:
        """See `Files.options`."""
        success = self.domain.known.success
        return {} if success is None else {"success": success.name}


class Gymnasium(Domain[Starts]):
    """A Gymnasium environment, such as gymnasium:CartPole-v1."""

    settings: GymnasiumSettings
    settings_type = GymnasiumSettings
    models: ClassVar[type[GymnasiumModels] | None] = None
    kinds = ("starts",)
    specialists = Specialists(group=8, widest=32, stall=100)
    pictures = EpisodePictures
    files = KnownFiles

    def __init__(
        self, settings: GymnasiumSettings | None = None, known: Known | None = None
    ) -> None:
        """The environment of the settings; what is not `known` is found out in random episodes.

        DomainError if Gymnasium is not installed, has no such environment, its spaces are not
        supported, or it is not known from when an episode is solved.
        """
        super().__init__(settings)
        self.episodes = _episodes(self.settings)
        self.vector: VectorSteps | None = None
        s = self.settings
        with suppress(LookupError):  # it has no vectorised environment that suits lanes
            self.vector = None if s.env or s.wrappers or s.success else VectorSteps(s.environment)
        self.percept = self.episodes.percepts.fields
        self.control = self.episodes.controls.fields
        if known is not None:
            self.known = known
        target = self._target()
        eager = known is not None or target is None or s.success
        self.target_return = self.known.target if eager else float(target or 0.0)

    @cached_property
    def known(self) -> Known:
        """What random episodes tell, which are played when it is first asked for."""
        return self._found()

    def sparing(self) -> "Gymnasium":
        """See `Sparing`: with rewards, numbers with bounds are scaled by these."""
        if "known" not in vars(self):
            target, scaling = self._target() or 0.0, self._scaled_by_bounds()
            return SparingGymnasium(self.settings, Known(scaling, target=target))
        return self if self.known.success else SparingGymnasium(self.settings, self.known)

    def pace(self) -> str:
        """See `Timed.pace`."""
        return self.episodes.pace()

    def _scaled_by_bounds(self) -> Scaling:
        """The scaling of numbers by their bounds, and of others by a few short random episodes."""
        low, high = bounds_of_percepts(self.episodes.percepts)
        known = low.isfinite() & high.isfinite() & (low < high)
        centre, scale = torch.zeros_like(low), torch.ones_like(low)
        if not bool(known.all()):
            seen = scaling_of(self.episodes.explored(FEW_LOOKS, FEW_STEPS).percepts)
            centre, scale = seen.centre, seen.scale
        middle, half = (low + high) / 2, (high - low) / 2
        return Scaling(torch.where(known, middle, centre), torch.where(known, half, scale))

    def draw(self, kind: str, count: int, generator: Generator) -> Starts:
        """See `Domain.draw`."""
        return Starts(torch.randint(2**31, (count,), generator=generator))

    def world(self, scenarios: Starts) -> GymnasiumWorld:
        """See `Domain.world`."""
        common = self.episodes, scenarios.seed, self.known.scaling
        if self.known.success is not None:
            return SuccessWorld(*common, told=self.known.success)
        if self.vector is not None:
            return VectorWorld(self.vector, *common, target=self.target_return)
        return PlayedWorld(*common, target=self.target_return)

    def actions(self) -> ActionSet:
        """See `Domain.actions`; there is a test where it may be success that ends an episode.

        The world ends these episodes by itself, but learned models do not.
        """
        sizes, success = (len(self.percept), len(self.control)), self.known.success
        every = reward_actions(*sizes, self.settings.hidden)
        ends = success is not None and not success.at_last
        return every.extended(["Test"], [Test()]) if ends else every

    def _found(self) -> Known:
        """What random episodes tell."""
        s, seen = self.settings, self.episodes.explored(LOOKS, STEPS)
        target, scaling = self._target(), scaling_of(seen.percepts)
        known = [name for name in FAMILIAR if name in seen.infos]
        name = s.success or (known[0] if known and target is None else "")
        if not name and target is None:
            raise DomainError(
                f"environment {s.environment!r} names no return from which it counts as solved; "
                "give one as target (--target), or a name in its info as success (--success)"
            )
        limit = ""
        if not seen.ended and self.episodes.most_steps == math.inf:
            limit = (
                f"No random episode ended within {STEPS} steps, and the environment names no "
                "largest number of steps; if its episodes do not end, give one "
                "(--env max_episode_steps=200)."
            )
        if not name:
            remarks = [limit] if limit else []
            return Known(scaling, target=target or 0.0, remark=" ".join(remarks + _alike(seen)))
        remark = "" if s.success else f"An episode is solved by {name} in the info of a step."
        if name not in seen.infos:
            others = f"only {', '.join(seen.infos)}" if seen.infos else "as infos were empty"
            remark = f"No info of {LOOKS} random episodes has {name}, {others}."
        mean, spread = float(seen.rewards.mean()), float(seen.rewards.std())
        varies = spread > EVEN * abs(seen.rewards).max()
        about = s.success_at == "last", mean, spread if varies else 1.0
        remark = " ".join(each for each in (remark, limit) if each)
        return Known(scaling, Success(name, *about), remark=remark)

    def _target(self) -> float | None:
        """The return from which an episode is solved: the one given, or the environment's own."""
        given = self.settings.target_return
        own = self.episodes.threshold
        if given != math.inf or own is None:
            return None if given == math.inf else given
        with suppress(TypeError, ValueError):
            if math.isfinite(number := float(own)):
                return number
        raise DomainError(
            f"environment {self.settings.environment!r} is registered with reward_threshold "
            f"{own!r:.60}; give a number there, or the return to reach as target (--target)"
        )


def _alike(seen: Explored) -> list[str]:
    """A remark if rewards of random episodes are too alike for their size to be told apart."""
    least, most = float(seen.rewards.min()), float(seen.rewards.max())
    size = max(abs(least), abs(most))
    if not 0 < most - least < SINGLE * size:
        return []
    return [
        f"Rewards of random episodes are as large as {size:g} and differ by {most - least:.2g} at "
        "most, which returns cannot tell in single precision; subtract a constant (--wrappers)."
    ]


class SparingGymnasium(Gymnasium):
    """An environment with rewards in which each step counts, as Γ is learned of it."""

    models = GymnasiumModels


def _success(data: Any) -> Success:
    """Success from its stored form; ValueError or TypeError if it is damaged."""
    name, at_last = str(data["name"]), bool(data["at_last"])
    found = Success(name, at_last, float(data["mean"]), float(data["spread"]))
    if vars(found) != data or not found.spread > 0:
        raise ValueError("success is not as it was stored")
    return found


def _episodes(settings: GymnasiumSettings) -> Episodes:
    """Episodes of the environment; DomainError if Gymnasium is not installed."""
    try:
        return Episodes(settings)
    except ImportError as e:
        raise DomainError(
            "domain 'gymnasium' needs package gymnasium; pip install 'cgtorch[gymnasium]'"
        ) from e


def scaling_of(percepts: NDArray[Any]) -> Scaling:
    """The scaling of numbers (N, D) of random episodes; constant numbers are not scaled.

    Bounds can be far too wide for scaling: divided by the bounds of a velocity, all values would be
    close to 0.
    """
    seen = torch.from_numpy(percepts).double()
    exponent = torch.frexp(seen.abs().amax(0)).exponent
    share = torch.ldexp(seen, -exponent)  # of a size whose squares are neither infinite nor 0
    spread = share.std(0)
    centre, scale = torch.ldexp(share.mean(0), exponent), torch.ldexp(spread, exponent)
    return Scaling(centre, torch.where(spread > EVEN, scale, 1.0))
