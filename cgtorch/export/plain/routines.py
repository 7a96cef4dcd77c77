"""The classes of an exported state machine that have to be implemented for a robot."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cgtorch.export.plain.machine import FAILURE, SUCCESS, State, Userdata


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


class MoveBase(State):
    """Carries out the message as a control.

    For a mobile robot it is a motion in the present frame of its base (x forward, y left): straight
    by dx and dy (m), then a turn by dθ (rad, to the left).
    """

    outcomes = (SUCCESS, FAILURE)
    control_size = 3

    def execute(self, userdata: Userdata) -> str:
        """Fail without a message that is a motion; else call `move`."""
        motion = userdata.message[: self.control_size]
        if not userdata.has_message or not all(map(math.isfinite, motion)):
            return FAILURE
        return SUCCESS if self.move(userdata, *motion) else FAILURE

    def move(self, userdata: Userdata, *motion: float) -> bool:
        """Carry the control out, then store the new percept in `userdata.percept`.

        Return False, without moving, if it cannot be carried out.
        """
        raise NotImplementedError("MoveBase.move is to be filled in")


class Detect(State):
    """Perceives again without moving."""

    outcomes = (SUCCESS,)

    def execute(self, userdata: Userdata) -> str:
        """Store the new percept."""
        userdata.percept = list(self.detect(userdata))
        return SUCCESS

    def detect(self, userdata: Userdata) -> list[float]:
        """The new percept."""
        raise NotImplementedError("Detect.detect is to be filled in")


class Grasp(State):
    """Tests success; a robot at a table tries to grasp the object."""

    outcomes = (SUCCESS, FAILURE)

    def execute(self, userdata: Userdata) -> str:
        """Test success."""
        return SUCCESS if self.grasp(userdata) else FAILURE

    def grasp(self, userdata: Userdata) -> bool:
        """Whether the task has succeeded, such as whether the robot now holds the object."""
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
