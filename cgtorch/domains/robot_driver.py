"""The interface of a robot: what it perceives, and one method for each of its routines."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from cgtorch.ground.fields import Field


class ProtectiveStop(Exception):  # noqa: N818  a state of the robot, no error of the program
    """Raise it where the robot has stopped for safety: the run pauses until somebody continues."""


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
