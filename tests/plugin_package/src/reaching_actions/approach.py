"""An action that drives up to the object."""

import torch
from torch import Tensor

from cgtorch import Action, Environment, Lanes
from cgtorch.ground.numerics import atan2

ARRIVED, BLOCKED, THERE = range(3)


class Approach(Action):
    """Turns to the object and drives up to it."""

    outcomes = ("arrived", "blocked", "there")
    num_parameters = 1  # stops 0.6 m + 0.1 m × parameter before the object

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        place = lanes.percept[:, 4:6]  # of the object: x, y in the robot's frame (m)
        distance = place.norm(dim=1)
        way = distance - (0.6 + 0.1 * parameters[:, 0])
        there = way.abs() < 0.05
        motion = place * (way / distance).masked_fill(there, 0)[:, None]
        turn = atan2(place[:, 1], place[:, 0])  # rad
        lanes, moved = environment.step(lanes, torch.cat([motion, turn[:, None]], 1))
        return lanes, torch.where(there, THERE, torch.where(moved, ARRIVED, BLOCKED))
