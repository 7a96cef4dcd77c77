"""The hand-written actions of section VI: MoveBase, Detect and Grasp."""

from collections.abc import Mapping

from torch import Tensor

from cgtorch.actions.action import Action
from cgtorch.environment import Environment, Lanes


class MoveBase(Action):
    """Carry out the message as a control; for the paper's robot dx, dy in m and dθ in rad.

    Fails, and changes nothing, if the environment cannot carry it out, or if there is no message.
    """

    outcomes: tuple[str, ...] = ("success", "failure")
    native_kind = "MOVE_BASE"

    def __init__(self, control_size: int = 3):
        super().__init__()
        self.message_size = control_size

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        control = lanes.message[:, : environment.control_size]
        # A lane without a message asks for an impossible motion, so it stays where it is.
        control = control.masked_fill(~lanes.has_message[:, None], float("nan"))
        lanes, moved = environment.step(lanes, control)
        return lanes, (~moved).long()


class Detect(Action):
    """Perceive again, as the paper's robot detects the table; always succeeds."""

    outcomes: tuple[str, ...] = ("success",)
    native_kind = "DETECT"

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        return environment.observe(lanes), lanes.step.new_zeros(len(lanes))


class Grasp(Action):
    """Test whether the task succeeds here, for example by a grasp; success ends the computation.

    If the environment returns a probability, success means more than one half (section III: C(p) >
    0.5).
    """

    outcomes: tuple[str, ...] = ("success", "failure")
    terminal: Mapping[str, bool] = {"success": True}
    native_kind = "GRASP"

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes, probability = environment.success(lanes)
        return lanes, (probability <= 0.5).long()
