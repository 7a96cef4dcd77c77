"""An action that draws random numbers."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch import Action, Environment, Lanes


class Wander(Action):
    """Makes up a motion for MoveBase, and says to which side it leads."""

    outcomes = ("left", "right")
    num_parameters = 1
    message_size = 3
    memory_size = 1  # its last number counts the draws
    deterministic = False

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, drawn = self.normal(lanes, environment, 3)  # (n, 3)
        motion = 0.3 * parameters.abs() * drawn  # dx, dy (m), dθ (rad)
        message = torch.cat([motion, lanes.message[:, 3:]], 1)
        lanes = replace(lanes, message=message, has_message=torch.ones_like(lanes.has_message))
        return lanes, (motion[:, 1] < 0).long()
