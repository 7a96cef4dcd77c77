"""A robot: the interface of its driver, and how each of its actions is logged before the next."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from cgtorch.domains.exploration import EXPLORATION
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import Dataset, Episode
from cgtorch.ground.errors import DomainError, RobotStoppedError, RunError
from cgtorch.ground.fields import Field
from cgtorch.ground.files import JsonLines
from cgtorch.ground.postponed import postponed


class ProtectiveStop(Exception):  # noqa: N818  a state of the robot, no error of the program
    """Raise it where the robot has stopped for safety: the run pauses until it is resumed."""


class RobotDriver(ABC):
    """One robot, in the state in which it is: no batch, no seed, nothing that is put back.

    A subclass has one method for each routine of its domain, with the routine's name in lower case:
    `step(control)` and `test()`, or for the tabletop `move_base(control)` and `grasp()`. The first
    gets U floats and returns whether the control was carried out. The second returns whether the
    task has succeeded here and now. An exception, or a call that takes longer than `seconds`, is an
    action that failed.

    Attributes:
        percept: The D fields of a percept, if the driver is a domain of its own.
        control: The U fields of a control, likewise.
        kinds: Kinds of scenes that `arrange` can be asked for.
        seconds: The longest time of an action, s.
    """

    percept: ClassVar[Sequence[Field]] = ()
    control: ClassVar[Sequence[Field]] = ()
    kinds: ClassVar[tuple[str, ...]] = ("any",)
    seconds: ClassVar[float] = 300.0

    @abstractmethod
    def perceive(self) -> Sequence[float]:
        """The D numbers of the percept here and now."""

    def arrange(self, kind: str) -> None:  # noqa: B027  a robot that needs none has none
        """Prepare the next episode, such as a new scene; it may ask a person and wait."""

    def stop(self) -> None:  # noqa: B027
        """End the routine that runs; called when it takes too long."""


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
        with postponed():
            self._call(lambda: self.driver.arrange(kind), float("inf"))
            percept = self.look(size)
            self._write("look", percept=_plain(percept[0]))
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
        """Whether a motion was carried out, or a test succeeded; logged before this returns.

        Nothing breaks it off, neither Ctrl-C nor the end of the time, as it would not be logged.
        """
        with postponed():
            return self._acted(what, before, control)

    def _acted(self, what: str, before: Tensor, control: Tensor | None) -> bool:
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
        return done

    def ended(self, succeeded: bool, percept: int, control: int) -> tuple[Dataset, Asked]:
        """Note the end of an episode; the data and cost of those broken off before it."""
        left, self._left = self._left, []
        self._write("episode", succeeded=succeeded, left=[e.number for e in left])
        rows = [a for e in left for a in e.actions]
        return dataset_of(rows, percept, control), asked_in(left)

    def _write(self, event: str, **row: Any) -> None:
        self.log.append({"event": event, "time": round(time.time(), 3), **self._about, **row})

    def _call(self, routine: Callable[[], Any], seconds: float) -> Any:
        """The result of a routine of the driver.

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
        try:
            result = future.result()
        except ProtectiveStop as e:
            raise RobotStoppedError(
                f"the robot has stopped for safety ({e}); release it, and resume the run (--resume)"
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
    """World actions of logged episodes, each of which began with a look."""
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
