"""What a robot has to do for a skill: the classes of an exported state machine to fill in."""

import math

from cgtorch.export.plain.machine import FAILURE, SUCCESS, State, Userdata


class MoveBase(State):
    """Carries out the message as a control."""

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
        raise NotImplementedError("Grasp.grasp is to be filled in")
