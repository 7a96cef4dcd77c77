"""Tasks of arms as domains, with primitives as actions and one stage for each task."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any, ClassVar

import torch
from torch import Generator

from cgtorch.domains.domain import Domain, Specialists
from cgtorch.domains.files import Files
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.graphs import ActionSet, BranchingNN
from cgtorch.ground.errors import DomainError
from cgtorch.manipulation import fetch, metaworld
from cgtorch.manipulation.arm import Arm, place_names
from cgtorch.manipulation.film import ArmPictures
from cgtorch.manipulation.models import ArmModels
from cgtorch.manipulation.primitives import Wait, primitives
from cgtorch.manipulation.settings import WITH_ID, FetchSettings, ManipulationSettings
from cgtorch.manipulation.simulator import Simulator
from cgtorch.manipulation.steer import Steer
from cgtorch.manipulation.strike import Strike
from cgtorch.manipulation.world import (
    CONTROL,
    ArmWorld,
    GradedArmWorld,
    Simulators,
    Starts,
)

MOST_SEEDS = 2**31
EVERY = "every-task"
"""The kind of starts of any task of a set."""


class ManipulationFiles(Files["Manipulation"]):
    """A domain of an arm stores nothing but its settings."""

    def made_with(self) -> Mapping[str, str]:
        """See `Files.made_with`."""
        from importlib.metadata import version

        return {name: version(name) for name in (self.domain.package, "mujoco")}


class Manipulation(Domain[Starts]):
    """Tasks of an arm; a subclass says of which simulator.

    Attributes:
        tasks: The distinct tasks by name; scenarios have their numbers.
        num_ids: The number of tasks that percepts tell apart, 0 if they do not.
        package: The package of the environments, whose version a run notes.
        seen: The names of what is seen, as `Simulator.perceive` returns it.
        places: The names of the places that primitives can move to.
        centre: (x, y, z) of the space that the arm works in, in m.
        make: The class of simulators.
        view: Azimuth and elevation in degrees, and distance in m, of films.
    """

    settings: ManipulationSettings
    settings_type = ManipulationSettings
    models: ClassVar[type[RewardedModels[Any]] | None] = None
    control = CONTROL
    specialists = Specialists(group=32, team=64, stall=8)
    files = ManipulationFiles
    pictures = ArmPictures
    view: ClassVar[tuple[float, float, float]] = (135.0, -30.0, 1.5)
    package: ClassVar[str]
    seen: ClassVar[tuple[str, ...]]
    places: ClassVar[tuple[str, ...]]
    centre: ClassVar[tuple[float, float, float]]
    make: ClassVar[Callable[..., Simulator]]

    def __init__(self, settings: ManipulationSettings | None = None) -> None:
        """The tasks of the settings; DomainError if there are none of that name."""
        super().__init__(settings)
        every = self.named(self.settings.environment)
        self.tasks = tuple(dict.fromkeys(every))
        self.kinds = (EVERY, *self.tasks) if len(self.tasks) > 1 else self.tasks
        self.stages = {f"{i:02}-{task}": task for i, task in enumerate(every, 1)}
        several = len(self.tasks) > 1 and self.settings.task_id == WITH_ID
        ids = self.tasks if several else ()
        self.num_ids = len(ids)
        self.arm = Arm((*self.seen, "time", *ids), self.places, self.centre)
        self.percept = self.arm.fields
        make = partial(self.make, horizon=self.settings.horizon)
        self.simulators = Simulators(make, self.tasks)

    @staticmethod
    @abstractmethod
    def named(name: str) -> tuple[str, ...]:
        """The tasks of a name, in the order of stages; DomainError if there are none."""

    @cached_property
    def _size(self) -> int:
        return max(self.simulators[number].size for number in range(len(self.tasks)))

    def draw(self, kind: str, count: int, generator: Generator) -> Starts:
        """See `Domain.draw`."""
        seed = torch.randint(MOST_SEEDS, (count,), generator=generator)
        if kind == EVERY:
            task = torch.randint(len(self.tasks), (count,), generator=generator)
        else:
            task = torch.full((count,), self.tasks.index(kind))
        return Starts(task, seed)

    def world(self, scenarios: Starts) -> ArmWorld:
        """See `Domain.world`."""
        return ArmWorld(scenarios, self.simulators, self.arm, self._size, self.num_ids)

    def actions(self) -> ActionSet:
        """See `Domain.actions`: primitives, and a network that branches."""
        made: dict[str, Any] = {**self.primitives(), "Branch": BranchingNN(len(self.percept))}
        return ActionSet(tuple(made), tuple(made.values()))

    def primitives(self) -> dict[str, Any]:
        """The primitives by name."""
        return primitives(self.arm)

    def sparing(self) -> "Manipulation":
        """See `Sparing`; DomainError, as what counts at the last step only tells too little."""
        raise DomainError(
            f"Γ is not learned of {self.settings.name}, where only the last step of an episode "
            "counts; evolve in the world itself: models 'none' (--models none)"
        )


class MetaWorld(Manipulation):
    """Tasks of Meta-World, such as metaworld:push-v3 or metaworld:CW10."""

    package = "metaworld"
    seen = (
        *place_names("hand"), "opening",
        *place_names("object"), *(f"object q{i}" for i in range(4)),
        *place_names("other"), *(f"other q{i}" for i in range(4)),
        *place_names("goal"),
    )  # fmt: skip
    places = ("object", "other", "goal")
    centre = (0.0, 0.65, 0.1)
    view = (155.0, -30.0, 1.4)
    make = metaworld.MetaWorldSimulator
    named = staticmethod(metaworld.tasks_of)

    def sparing(self) -> "SparingMetaWorld":
        """See `Sparing`."""
        return SparingMetaWorld(self.settings)


class SparingMetaWorld(MetaWorld):
    """A single task in which each segment counts, as Γ is learned of it."""

    models = ArmModels
    target_return = 0.97

    def __init__(self, settings: ManipulationSettings) -> None:
        """The task of the settings; DomainError if there are several."""
        super().__init__(settings)
        if len(self.tasks) > 1:
            raise DomainError(
                f"{settings.name!r} has {len(self.tasks)} tasks, and Γ is learned of a single one; "
                f"name one, such as metaworld:{self.tasks[0]}, or evolve in the world itself: "
                "models 'none' (--models none)"
            )

    def world(self, scenarios: Starts) -> GradedArmWorld:
        """See `Domain.world`."""
        return GradedArmWorld(scenarios, self.simulators, self.arm, self._size, self.num_ids)


class Fetch(Manipulation):
    """Tasks of Gymnasium-Robotics' Fetch, such as gymnasium-robotics:FetchPush-v4."""

    settings_type = FetchSettings
    package = "gymnasium-robotics"
    seen = (*place_names("hand"), *place_names("object"), *place_names("goal"), "opening")
    places = ("object", "goal")
    centre = (1.34, 0.75, 0.5)
    make = fetch.FetchSimulator
    named = staticmethod(fetch.tasks_of)

    def primitives(self) -> dict[str, Any]:
        """See `Manipulation.primitives`: shorter ones, as a low-level step is longer.

        FetchSlide, whose object slides on, has `Strike`, too, and FetchPush has `Steer` in place of
        `PushTo`, which aims only once.
        """
        pace = 1 / 3
        made = {**primitives(self.arm, pace), "Wait": Wait(self.arm, "object", pace)}
        if fetch.SLIDE in self.tasks:
            made["Strike"] = Strike(self.arm, "object", pace)
        if fetch.PUSH in self.tasks:
            del made["PushTo"]
            made["Steer"] = Steer(self.arm, "object", pace)
        return made
