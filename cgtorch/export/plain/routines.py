"""What a robot has to do for a skill: the classes of an exported state machine to fill in."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cgtorch.export.plain.machine import FAILURE, SUCCESS, State, Userdata


@dataclass(frozen=True)
class ArmCommand:
    """What an arm does to grasp an object and lift it: where its joints are when.

    Attributes:
        arm: its name in the robot description.
        joints: names of its n joints in the URDF, from base to tool.
        gripper: names of the gripper's g joints that have a motor.
        times: T times (s) from the beginning, ascending.
        positions: T rows of n positions (rad or m), between which the joints move evenly.
        openings: T rows of g positions of the gripper's joints (rad or m), open at first; from
            where they close on, the object keeps them apart.
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

    That of a mobile robot is a motion in the frame its base is in before (x forward, y left):
    straight by dx and dy (m), then a turn by dθ (rad, to the left).
    """

    outcomes = (SUCCESS, FAILURE)
    control_size = 3

    def execute(self, userdata: Userdata) -> str:
        """Fail without a message that is a motion; else `move`."""
        motion = userdata.message[: self.control_size]
        if not userdata.has_message or not all(map(math.isfinite, motion)):
            return FAILURE
        return SUCCESS if self.move(userdata, *motion) else FAILURE

    def move(self, userdata: Userdata, *motion: float) -> bool:
        """Carry the control out, then keep the new `userdata.percept`.

        False, without moving, where it cannot be carried out.
        """
        raise NotImplementedError("MoveBase.move is to be filled in")


class Detect(State):
    """Perceives again without moving."""

    outcomes = (SUCCESS,)

    def execute(self, userdata: Userdata) -> str:
        """Keep the new percept."""
        userdata.percept = list(self.detect(userdata))
        return SUCCESS

    def detect(self, userdata: Userdata) -> list[float]:
        """The new percept."""
        raise NotImplementedError("Detect.detect is to be filled in")


class Grasp(State):
    """Tests success; a robot at a table tries to grasp the object."""

    outcomes = (SUCCESS, FAILURE)

    def execute(self, userdata: Userdata) -> str:
        """Whether success is met."""
        return SUCCESS if self.grasp(userdata) else FAILURE

    def grasp(self, userdata: Userdata) -> bool:
        """Whether the task has succeeded, such as whether the robot now holds the object."""
        command = self.plan(userdata)
        return command is not None and self.carry_out(command)

    def plan(self, userdata: Userdata) -> ArmCommand | None:
        """How the object that is perceived is grasped; None if it cannot be.

        `cgtorch.tabletop.arm_command.arm_command` says so of a percept, or a planner of your own.
        """
        raise NotImplementedError("Grasp.plan, or Grasp.grasp, is to be filled in")

    def carry_out(self, command: ArmCommand) -> bool:
        """Do what the command says; whether the gripper then holds the object."""
        raise NotImplementedError("Grasp.carry_out is to be filled in")
