"""The hand-written actions of section VI: MoveBase, Detect and Grasp."""

from collections.abc import Mapping

from torch import Tensor

from cgtorch.actions.action import Action
from cgtorch.environment import Environment, Lanes


class MoveBase(Action):
    """Move the robot base by the message (dx, dy in m, dθ in rad), in the robot's own frame.

    Fails, without moving, if an obstacle lies along the way or no message has been sent.
    """

    outcomes: tuple[str, ...] = ("success", "failure")
    message_size: int = 3

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
    """Detect the table and the object again; always succeeds, the table being in view."""

    outcomes: tuple[str, ...] = ("success",)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        return environment.observe(lanes), lanes.step.new_zeros(len(lanes))


class Grasp(Action):
    """Try to grasp the object; success ends the computation.

    Where the environment answers with a probability, it counts as success above one half
    (section III: C(p) > 0.5).
    """

    outcomes: tuple[str, ...] = ("success", "failure")
    terminal: Mapping[str, bool] = {"success": True}

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes, probability = environment.success(lanes)
        return lanes, (probability <= 0.5).long()
