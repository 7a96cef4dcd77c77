"""What the nodes of a skill can do: say how hard to push, push, and look which way to go on."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.actions import Action, ActionSet, BranchingNN, ContinuousNN
from cgtorch.environment import Environment, Lanes


class Throttle(Action):
    """Sets the force to its one parameter."""

    num_parameters = 1
    message_size = 1

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        message = lanes.message.clone()
        message[:, :1] = parameters
        lanes = replace(lanes, message=message, has_message=torch.ones_like(lanes.has_message))
        return lanes, lanes.step.new_zeros(len(lanes))


class Push(Action):
    """Pushes with the force that was last set, between -1 and 1, and looks whether that was it."""

    outcomes: tuple[str, ...] = ("rolling", "arrived", "over")
    terminal: Mapping[str, bool] = {"arrived": True, "over": False}
    message_size = 1

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes, moved = environment.step(lanes, lanes.message[:, :1].clamp(-1, 1))
        lanes, chance = environment.success(lanes)
        return lanes, torch.where(moved, (chance > 0.5).long(), 2)


def car_actions() -> ActionSet:
    """Two actions of its own and the two networks of the library, which read two numbers here."""
    return ActionSet(
        ("Throttle", "Steer", "Push", "Branch"),
        (Throttle(), ContinuousNN(inputs=2, outputs=1), Push(), BranchingNN(inputs=2)),
    )
