"""A robot as a world: one lane, which cannot be put back."""

import copy
import re
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.pictures import Pictures
from cgtorch.domains.robot import Robot, RobotDriver
from cgtorch.graphs import ActionSet, Step, Test
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Dataset, Episode, Lanes, ScenarioBatch
from cgtorch.ground.errors import DomainError
from cgtorch.ground.files import JsonLines


@dataclass(frozen=True)
class Placements(ScenarioBatch):
    """Scenes that are arranged when their turn comes: a kind, by its index, and a number."""

    kind: Tensor
    number: Tensor


class LiveWorld:
    """An `Environment` of scenes in front of one robot, which are met one after the other.

    Lanes are single rows. Their state (1, 1) counts actions, so a lane that the robot has left
    behind is noticed. Each action is a line of the log: what was asked, the percept before and
    after, the outcome, and how long it took.
    """

    def __init__(self, domain: "Domain[Placements]", scenes: Placements, robot: Any):
        """The world of some scenes."""
        self.scenes, self.robot, self.kinds = scenes, robot, domain.kinds
        self.percept_size, self.control_size = len(domain.percept), len(domain.control)
        self._phase, self._stage = "trials", ""

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.scenes)

    def told(self, phase: str, stage: str) -> None:
        """See `Live.told`."""
        self._phase, self._stage = phase, stage

    def recall(self) -> Episode | None:
        """See `Live.recall`."""
        return self.robot.recall(self._stage, self.control_size)

    def ended(self, succeeded: bool) -> tuple[Dataset, Asked]:
        """See `Live.ended`."""
        return self.robot.ended(succeeded, self.percept_size, self.control_size)

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`: the scene is arranged, and looked at."""
        if len(scenario) != 1:
            raise DomainError(f"a robot cannot start {len(scenario)} scenarios at once; one by one")
        kind = self.kinds[int(self.scenes.kind[scenario[0]])]
        percept = self.robot.begin(kind, self._phase, self._stage, self.percept_size)
        return self._state(), percept

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        self._check(lanes)
        if not control.isfinite().all():
            return lanes, torch.zeros(1, dtype=torch.bool)
        done = self.robot.act("motion", lanes.percept[0], control[0])
        return lanes.moved(self._state(), self.robot.seen), torch.tensor([done])

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        self._check(lanes)
        return lanes.moved(lanes.state, self.robot.look(self.percept_size))

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        self._check(lanes)
        done = self.robot.act("test", lanes.percept[0], None)
        return replace(lanes, state=self._state()), torch.tensor([float(done)])

    def _state(self) -> Tensor:
        return torch.tensor([[float(self.robot.actions)]])

    def _check(self, lanes: Lanes) -> None:
        if len(lanes) != 1 or not torch.equal(lanes.state, self._state()):
            raise DomainError(
                "a robot cannot go back to where it was; run one skill on one scenario at a time"
            )


def routine_names(actions: ActionSet) -> tuple[str, str]:
    """The names of the methods that carry out a motion and a test, by those of the actions."""
    found = []
    for kind in (Step, Test):
        names = zip(actions.names, actions.actions, strict=True)
        name = next((name for name, action in names if isinstance(action, kind)), None)
        if name is None:
            raise DomainError(f"among {', '.join(actions.names)} is no {kind.__name__}; add one")
        found.append(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower())
    return found[0], found[1]


class _Unseen(Pictures[Any]):
    """The pictures of a domain whose world is a robot."""

    def scenarios(self, *about: Any, **more: Any) -> None:
        """See `Pictures.scenarios`: the places of things are unknown here."""

    def film(self, *about: Any, **more: Any) -> None:
        """See `Pictures.film`: a picture is no reason for a robot to move."""


class OnRobot(Domain[Placements]):
    """A domain whose world is a robot; `on_robot` mixes it into the domain's class."""

    repeats = False
    actor: Robot
    simulated: Domain[Any]

    def draw(self, kind: str, count: int, generator: Generator) -> Placements:
        """See `Domain.draw`: scenes that the driver will arrange."""
        return Placements(torch.full((count,), self.kinds.index(kind)), torch.arange(count))

    def world(self, scenarios: Placements) -> LiveWorld:
        """See `Domain.world`."""
        return LiveWorld(self, scenarios, self.actor)

    def tests(self, kind: str) -> Placements:
        """See `Domain.tests`: as many as the simulated domain has."""
        return self.draw(kind, len(self.simulated.tests(kind)), Generator())


def on_robot(domain: Domain[Any], driver: RobotDriver, log: JsonLines) -> OnRobot:
    """The domain with a robot in place of its simulated world."""
    pictures = type("Unseen", (_Unseen, domain.pictures), {})
    kind = type(f"Live{type(domain).__name__}", (OnRobot, type(domain)), {"pictures": pictures})
    live: OnRobot = copy.copy(domain)  # type: ignore[assignment]
    live.__class__ = kind
    live.repeats = False
    live.actor = Robot(driver, routine_names(domain.actions()), log)
    live.simulated = domain
    return live


class _NoRobot:
    """In place of a robot where only its driver's class is known."""

    def __init__(self, driver: type[RobotDriver]) -> None:
        self.driver = driver

    def begin(self, *about: Any) -> Tensor:
        """DomainError, as nothing can begin."""
        raise DomainError(
            f"{self.driver.__name__} is a robot and has no simulated world; only a training acts "
            "on it"
        )


class DriverDomain(Domain[Placements]):
    """The domain of a driver that names its percepts and controls.

    Attributes:
        driver: The driver's class.
    """

    driver: ClassVar[type[RobotDriver]]

    def draw(self, kind: str, count: int, generator: Generator) -> Placements:
        """See `Domain.draw`."""
        return Placements(torch.full((count,), self.kinds.index(kind)), torch.arange(count))

    def world(self, scenarios: Placements) -> LiveWorld:
        """See `Domain.world`; without a robot it does not begin."""
        return LiveWorld(self, scenarios, _NoRobot(self.driver))


def domain_of_driver(driver: type[RobotDriver]) -> type[DriverDomain]:
    """The class of a driver's own domain; DomainError if it does not name its numbers."""
    if not driver.percept or not driver.control:
        raise DomainError(
            f"driver {driver.__name__} names no percept or no control; give a Field for each "
            "number, or a domain (--domain) besides the driver (--driver)"
        )
    about = {
        "driver": driver, "percept": driver.percept, "control": driver.control,
        "kinds": driver.kinds,
    }  # fmt: skip
    return type(driver.__name__, (DriverDomain,), about)
