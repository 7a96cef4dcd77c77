"""The routines of section VI in exported state machines, to be implemented for a robot."""

from collections.abc import Sequence
from dataclasses import dataclass

from cgtorch.export.plain import Perceive, Step, Test, Userdata


@dataclass(frozen=True)
class ArmCommand:
    """Joint positions over time for an arm to grasp an object and lift it.

    Attributes:
        arm: Its name in the robot description.
        joints: Names of its n joints in the URDF, from base to tool.
        gripper: Names of the gripper's g joints with a motor.
        times: T times (s) from the beginning, ascending.
        positions: T rows of n positions (rad or m), between which the joints move evenly.
        openings: T rows of g positions of the gripper's joints (rad or m), first open, then closed;
            the object keeps the fingers apart.
        effort: g forces (N m or N) that the gripper's joints should not exceed.
    """

    arm: str
    joints: Sequence[str]
    gripper: Sequence[str]
    times: Sequence[float]
    positions: Sequence[Sequence[float]]
    openings: Sequence[Sequence[float]]
    effort: Sequence[float]


class MoveBase(Step):
    """Drives straight by dx and dy (m; x forward, y left), then turns by dθ (rad, to the left)."""

    control_size = 3

    def step(self, userdata: Userdata, *control: float) -> bool:
        """Call `move`."""
        return self.move(userdata, *control)

    def move(self, userdata: Userdata, *motion: float) -> bool:
        """Drive, then store the new percept in `userdata.percept`.

        Return False, without moving, if the way is blocked.
        """
        raise NotImplementedError("MoveBase.move is to be filled in")


class Detect(Perceive):
    """Perceives again without moving."""

    def perceive(self, userdata: Userdata) -> list[float]:
        """Call `detect`."""
        return list(self.detect(userdata))

    def detect(self, userdata: Userdata) -> list[float]:
        """The new percept."""
        raise NotImplementedError("Detect.detect is to be filled in")


class Grasp(Test):
    """Tries to grasp the object."""

    def test(self, userdata: Userdata) -> bool:
        """Call `grasp`."""
        return self.grasp(userdata)

    def grasp(self, userdata: Userdata) -> bool:
        """Whether the robot now holds the object."""
        command = self.plan(userdata)
        return command is not None and self.carry_out(command)

    def plan(self, userdata: Userdata) -> ArmCommand | None:
        """The arm command to grasp the perceived object; None if that is impossible.

        `cgtorch.tabletop.arm_command.arm_command` computes it from a percept; you can also use your
        own planner.
        """
        raise NotImplementedError("Grasp.plan, or Grasp.grasp, is to be filled in")

    def carry_out(self, command: ArmCommand) -> bool:
        """Carry out the command; return whether the gripper then holds the object."""
        raise NotImplementedError("Grasp.carry_out is to be filled in")
