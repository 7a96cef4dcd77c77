"""The classes of an exported state machine that have to be implemented for a robot."""

import math

from cgtorch.export.plain.machine import FAILURE, SUCCESS, State, Userdata


class Step(State):
    """Carries out the message as a control."""

    outcomes = (SUCCESS, FAILURE)
    control_size = 1

    def execute(self, userdata: Userdata) -> str:
        """Fail without a message that is a control; else call `step`."""
        control = userdata.message[: self.control_size]
        if not userdata.has_message or not all(map(math.isfinite, control)):
            return FAILURE
        return SUCCESS if self.step(userdata, *control) else FAILURE

    def step(self, userdata: Userdata, *control: float) -> bool:
        """Carry the control out, then store the new percept in `userdata.percept`.

        Return False, without acting, if it cannot be carried out.
        """
        raise NotImplementedError("Step.step is to be filled in")


class Perceive(State):
    """Perceives again without acting."""

    outcomes = (SUCCESS,)

    def execute(self, userdata: Userdata) -> str:
        """Store the new percept."""
        userdata.percept = list(self.perceive(userdata))
        return SUCCESS

    def perceive(self, userdata: Userdata) -> list[float]:
        """The new percept."""
        raise NotImplementedError("Perceive.perceive is to be filled in")


class Test(State):
    """Tests success."""

    __test__ = False  # for pytest, which takes names like this one for tests

    outcomes = (SUCCESS, FAILURE)

    def execute(self, userdata: Userdata) -> str:
        """Test success."""
        return SUCCESS if self.test(userdata) else FAILURE

    def test(self, userdata: Userdata) -> bool:
        """Whether the task has succeeded."""
        raise NotImplementedError("Test.test is to be filled in")
