"""The actions that ask the robot: carry out a control, perceive again, and test success."""

from collections.abc import Mapping

from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.ground.environment import Environment, Lanes


class Step(Action):
    """Carry out the message as a control.

    Fails, and changes nothing, if the environment cannot carry it out, or if there is no message.
    """

    outcomes: tuple[str, ...] = ("success", "failure")
    native_kind = "STEP"
    request = "control"
    plain_module = "cgtorch.export.plain"

    def __init__(self, control_size: int):
        super().__init__()
        self.message_size = self.control_size = control_size

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        control = lanes.message[:, : environment.control_size]
        # A lane without a message asks for an impossible motion, so it stays where it is.
        control = control.masked_fill(~lanes.has_message[:, None], float("nan"))
        lanes, moved = environment.step(lanes, control)
        return lanes, (~moved).long()


class Perceive(Action):
    """Perceive again without acting; always succeeds."""

    outcomes: tuple[str, ...] = ("success",)
    native_kind = "PERCEIVE"
    request = "perceive"
    plain_module = "cgtorch.export.plain"

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        return environment.observe(lanes), lanes.step.new_zeros(len(lanes))


class Test(Action):
    """Test whether the task succeeds here; success ends the computation.

    If the environment returns a probability, success means more than one half (section III: C(p) >
    0.5).
    """

    __test__ = False  # for pytest, which takes names like this one for tests

    outcomes: tuple[str, ...] = ("success", "failure")
    terminal: Mapping[str, bool] = {"success": True}
    native_kind = "TEST"
    request = "test"
    plain_module = "cgtorch.export.plain"

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes, probability = environment.success(lanes)
        return lanes, (probability <= 0.5).long()
