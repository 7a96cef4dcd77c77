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
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain, Specialists
from cgtorch.domains.files import Files
from cgtorch.domains.film import Film
from cgtorch.domains.gymnasium_episodes import LIMITING, Episodes
from cgtorch.domains.gymnasium_film import MODE
from cgtorch.domains.gymnasium_known import Known, found_out, sparingly_found_out
from cgtorch.domains.gymnasium_models import GymnasiumModels
from cgtorch.domains.gymnasium_scaling import Scaling
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import (
    GymnasiumWorld,
    PlayedWorld,
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
LONG = 1000  # steps of an episode that may never end


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """Initial states of episodes, given by the `seed` (B,) long of `reset`."""

    seed: Tensor


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

    def advice(self) -> str:
        """See `Pictures.advice`: where episodes did not end."""
        episodes = self.domain.episodes
        if episodes.most_steps < math.inf or (unended := episodes.unended()) < LONG:
            return ""
        return (
            f"an episode of {unended:,} steps had not ended, so it had no return; train anew with "
            f"a limit of steps ({LIMITING})"
        )

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
        return found_out(self.settings, self.episodes, self._target())

    def sparing(self) -> "Gymnasium":
        """See `Sparing`: with rewards, numbers with telling bounds are scaled by these."""
        if "known" not in vars(self):
            return SparingGymnasium(self.settings)
        return self if self.known.success else SparingGymnasium(self.settings, self.known)

    def pace(self) -> str:
        """See `Timed.pace`."""
        return self.episodes.pace()

    def draw(self, kind: str, count: int, generator: Generator) -> Starts:
        """See `Domain.draw`; DomainError for another kind than `kinds`."""
        if kind not in self.kinds:
            raise DomainError(
                f"Gymnasium has no scenarios {kind!r:.40}; use one of {', '.join(self.kinds)}"
            )
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


class SparingGymnasium(Gymnasium):
    """An environment with rewards in which each step counts, as Γ is learned of it."""

    models = GymnasiumModels

    @cached_property
    def known(self) -> Known:
        """What a few short random episodes tell, which are played when it is first asked for."""
        return sparingly_found_out(self.episodes, self._target() or 0.0)


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
