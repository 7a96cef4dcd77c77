"""A robot as a world: one lane, every action logged before the next begins."""

import copy
import re
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.exploration import EXPLORATION
from cgtorch.domains.registry import domain_class, is_code
from cgtorch.domains.robot_driver import ProtectiveStop, RobotDriver
from cgtorch.graphs import ActionSet, Step, Test
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Dataset, Episode, Lanes, ScenarioBatch
from cgtorch.ground.errors import DomainError, RobotStoppedError, RunError
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

    def __init__(self, domain: "Domain[Placements]", scenes: Placements, robot: "Robot"):
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
        return torch.tensor([[float(self.robot.actions % 2**24)]])

    def _check(self, lanes: Lanes) -> None:
        if len(lanes) != 1 or not torch.equal(lanes.state, self._state()):
            raise DomainError(
                "a robot cannot go back to where it was; run one skill on one scenario at a time"
            )


class Robot:
    """A driver with its log; it knows the last percept and how often it has acted."""

    def __init__(self, driver: RobotDriver, names: Sequence[str], log: JsonLines):
        """The robot of a driver, whose routines have these names: a motion, and a test."""
        self.driver, self.log, self.actions, self.episode = driver, log, 0, 0
        self.seen = torch.zeros(1, 0)
        self._routines = dict(zip(("motion", "test"), names, strict=True))
        for what, name in self._routines.items():
            if not callable(getattr(driver, name, None)):
                raise DomainError(
                    f"driver {type(driver).__name__} has no method {name}, which carries out a "
                    f"{what}; give it one"
                )
        self._worker = ThreadPoolExecutor(1, "robot")
        self._interrupted = False
        self._logged = episodes_in(log.rows())
        every = [each for one in self._logged for each in (*one.left, one)]
        self.actions = sum(len(each.actions) for each in every)
        self.episode = max((each.number for each in every), default=0)
        self._left = [e for e in self._logged if e.succeeded is None and e.phase != EXPLORATION]

    def explored(self, percept: int, control: int) -> tuple[Dataset, Asked]:
        """The data of an exploration that an earlier process has begun, and what it asked."""
        episodes = [e for e in self._logged if e.phase == EXPLORATION]
        rows = [a for e in episodes for a in e.actions]
        return dataset_of(rows, percept, control), asked_in(episodes)

    def recall(self, stage: str, control: int) -> Episode | None:
        """The next finished episode of a stage in the log, None if there are no more."""
        for each in self._logged:
            if each.stage == stage and each.phase != EXPLORATION and each.succeeded is not None:
                self._logged.remove(each)
                return each.episode(control)
        return None

    def begin(self, kind: str, phase: str, stage: str, size: int) -> Tensor:
        """(1, D) the first percept of a new episode, after the scene was arranged."""
        self.episode += 1
        self._about = {"stage": stage, "phase": phase, "episode": self.episode}
        self._call(lambda: self.driver.arrange(kind), float("inf"))
        percept = self.look(size)
        self._write("look", percept=_plain(percept[0]))
        self._pause()
        return percept

    def look(self, size: int) -> Tensor:
        """(1, D) the percept here and now; DomainError if it is none."""
        found = self._call(self.driver.perceive, float("inf"))
        try:
            percept = torch.tensor([[float(x) for x in found]])
        except (TypeError, ValueError):
            percept = torch.zeros(1, 0)
        if percept.shape[1] != size or not percept.isfinite().all():
            raise DomainError(
                f"{type(self.driver).__name__}.perceive returned {found!r:.60}; return {size} "
                "finite numbers"
            )
        self.seen = percept
        return percept

    def act(self, what: str, before: Tensor, control: Tensor | None) -> bool:
        """Whether a motion was carried out, or a test succeeded; logged before this returns."""
        routine = getattr(self.driver, self._routines[what])
        given = () if control is None else (tuple(control.tolist()),)
        began, error = time.monotonic(), ""
        try:
            done = bool(self._call(lambda: routine(*given), self.driver.seconds))
        except (RobotStoppedError, DomainError):
            raise
        except Exception as e:  # whatever a robot's program raises, its action has failed
            done, error = False, f"{type(e).__name__}: {e}"[:200]
        after = self.look(len(before))
        self.actions += 1
        row = {"percept": _plain(before), "done": done, "next": _plain(after[0])}
        if control is not None:
            row["control"] = _plain(control)
        if error:
            row["error"] = error
        self._write("action", what=what, seconds=round(time.monotonic() - began, 3), **row)
        self._pause()
        return done

    def ended(self, succeeded: bool, percept: int, control: int) -> tuple[Dataset, Asked]:
        """Note the end of an episode; the data and cost of those broken off before it."""
        left, self._left = self._left, []
        self._write("episode", succeeded=succeeded, left=[e.number for e in left])
        rows = [a for e in left for a in e.actions]
        return dataset_of(rows, percept, control), asked_in(left)

    def _pause(self) -> None:
        """KeyboardInterrupt if somebody has interrupted a routine of the driver."""
        if self._interrupted:
            self._interrupted = False
            raise KeyboardInterrupt

    def _write(self, event: str, **row: Any) -> None:
        self.log.append({"event": event, "time": round(time.time(), 3), **self._about, **row})

    def _call(self, routine: Callable[[], Any], seconds: float) -> Any:
        """The result of a routine of the driver, run to its end even if someone interrupts.

        TimeoutError after `seconds`, once the routine has ended; RobotStoppedError if the robot has
        stopped for safety.
        """
        future, began, late = self._worker.submit(routine), time.monotonic(), False
        while not future.done():
            try:
                future.exception(timeout=0.2)
            except TimeoutError:
                if not late and time.monotonic() - began > seconds:
                    late = True
                    self.driver.stop()
            except KeyboardInterrupt:
                self._interrupted = True  # after the running motion
        try:
            result = future.result()
        except ProtectiveStop as e:
            raise RobotStoppedError(
                f"the robot has stopped for safety ({e}); release it, and continue with --resume"
            ) from e
        if late:
            raise TimeoutError(f"it took more than {seconds:g} s")
        return result


@dataclass(frozen=True)
class Logged:
    """An episode in the log; `succeeded` is None if it was broken off.

    `left` are those broken off before it whose data came with its own.
    """

    stage: str
    phase: str
    number: int
    percept: list[float]
    actions: list[dict[str, Any]]
    succeeded: bool | None
    left: tuple["Logged", ...] = ()

    def episode(self, control: int) -> Episode:
        """The same as tensors, with controls (N, U)."""
        every = (*self.left, self)
        rows = [a for each in every for a in each.actions]
        experience = dataset_of(rows, len(self.percept), control)
        asked = asked_in(every) + Asked(episodes=1)
        about = torch.tensor([self.percept]), experience, len(self.actions), asked
        return Episode(*about, bool(self.succeeded))


def asked_in(episodes: Sequence[Logged]) -> Asked:
    """What was asked in logged episodes, each of which began with a look."""
    rows = [a for each in episodes for a in each.actions]
    motions = sum(a["what"] == "motion" for a in rows)
    return Asked(motions, len(rows) - motions, looks=len(episodes))


def episodes_in(rows: Iterable[dict[str, Any]]) -> list[Logged]:
    """The episodes of a log, in order; RunError for a line that lacks something."""
    found: dict[int, Logged] = {}
    for row in rows:
        try:
            if row["event"] == "look":
                about = row["stage"], row["phase"], row["episode"], row["percept"]
                found[row["episode"]] = Logged(*about, [], None)
            elif row["event"] == "action":
                found[row["episode"]].actions.append(row)
            elif row["event"] == "episode":
                each = found[row["episode"]]
                left = tuple(found.pop(number) for number in row.get("left", ()))
                found[row["episode"]] = replace(each, succeeded=row["succeeded"], left=left)
        except (KeyError, TypeError) as e:
            raise RunError(f"the log has a line without {e}: {row!s:.60}; restore it") from e
    return list(found.values())


def dataset_of(actions: Sequence[dict[str, Any]], percept: int, control: int) -> Dataset:
    """The data in logged actions, with percepts (N, D) and controls (N, U)."""
    moved = [a for a in actions if a["what"] == "motion" and a["done"]]
    tests = [a for a in actions if a["what"] == "test"]
    return Dataset(
        torch.tensor([a["percept"] for a in moved]).view(-1, percept),
        torch.tensor([a["control"] for a in moved]).view(-1, control),
        torch.tensor([a["next"] for a in moved]).view(-1, percept),
        torch.tensor([a["percept"] for a in tests]).view(-1, percept),
        torch.tensor([a["done"] for a in tests], dtype=torch.bool),
    )


def _plain(numbers: Tensor) -> list[float]:
    return [float(f"{x:.9g}") for x in numbers.tolist()]  # which a float32 is read from again


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


class OnRobot(Domain[Placements]):
    """A domain whose world is a robot; `on_robot` mixes it into the domain's class."""

    live = True
    repeats = False
    actor: Robot
    simulated: Domain[Any]

    def draw(self, kind: str, count: int, generator: Generator) -> Placements:
        """See `Domain.draw`: scenes that somebody will arrange."""
        return Placements(torch.full((count,), self.kinds.index(kind)), torch.arange(count))

    def world(self, scenarios: Placements) -> LiveWorld:
        """See `Domain.world`."""
        return LiveWorld(self, scenarios, self.actor)

    def tests(self, kind: str) -> Placements:
        """See `Domain.tests`: as many as the simulated domain has."""
        return self.draw(kind, len(self.simulated.tests(kind)), Generator())

    def draw_scenarios(self, *about: Any, **more: Any) -> None:
        """See `Domain.draw_scenarios`: nobody knows where things are in these scenes."""


def on_robot(domain: Domain[Any], driver: RobotDriver, log: JsonLines) -> OnRobot:
    """The domain with a robot in place of its simulated world."""
    kind = type(f"Live{type(domain).__name__}", (OnRobot, type(domain)), {})
    live: OnRobot = copy.copy(domain)  # type: ignore[assignment]
    live.__class__ = kind
    live.repeats = False
    live.actor = Robot(driver, routine_names(domain.actions()), log)
    live.simulated = domain
    return live


class DriverDomain(Domain[Placements]):
    """The domain of a driver that names its percepts and controls.

    Attributes:
        driver: The driver's class.
    """

    driver: ClassVar[type[RobotDriver]]

    def draw(self, kind: str, count: int, generator: Generator) -> Placements:
        """See `Domain.draw`."""
        return Placements(torch.full((count,), self.kinds.index(kind)), torch.arange(count))

    def world(self, scenarios: Placements) -> Any:
        """See `Domain.world`; it needs a robot."""
        raise DomainError(
            f"{self.driver.__name__} is a robot and has no simulated world; only cgtorch-train "
            "works with it"
        )

    @property
    def rewarded(self) -> bool:
        """See `Domain.rewarded`: a robot gives none."""
        return False


def domain_of_driver(driver: type[RobotDriver]) -> type[DriverDomain]:
    """The class of a driver's own domain; DomainError if it does not name its numbers."""
    if not driver.percept or not driver.control:
        raise DomainError(
            f"driver {driver.__name__} names no percept or no control; give a Field for each "
            "number, or --domain and --driver"
        )
    about = {
        "driver": driver, "percept": driver.percept, "control": driver.control,
        "kinds": driver.kinds,
    }  # fmt: skip
    return type(driver.__name__, (DriverDomain,), about)


def driver_of(spec: str) -> str:
    """The name of a domain if it is that of a driver, else ""."""
    return spec if is_code(spec) and issubclass(domain_class(spec), DriverDomain) else ""
