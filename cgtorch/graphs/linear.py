"""Linear networks of the percept, and of the percept with its latest changes."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.graphs.light import light_layer
from cgtorch.ground.environment import Environment, Lanes

CHANGE = 10.0
"""The factor of changes between steps; `native/engine/memory.h` has the same."""


def percept_and_changes(x: Tensor, earlier: Tensor) -> Tensor:
    """The inputs of a `DelayNN`, (n, (d + 1) * D): percepts, then ten times the latest changes.

    `x` (n, D) are percepts, and `earlier` (n, d * D) are the d percepts before them, the latest
    first. The changes have the same order.
    """
    window = torch.cat([x, earlier], -1).unflatten(-1, (-1, x.shape[-1]))
    changes = CHANGE * (window[..., :-1, :] - window[..., 1:, :])
    return torch.cat([x, changes.flatten(-2)], -1)


class DelayNN(Action):
    """A linear network of the percept and its latest changes, whose output is sent as a message.

    It sends V s + c. The vector s is the percept x(t) followed by ten times the changes x(t) -
    x(t-1), x(t-1) - x(t-2), and so on. This is a tapped delay line (Waibel et al., "Phoneme
    recognition using time-delay neural networks", IEEE Trans. ASSP 37, 1989) in the basis of
    backward differences. A change in one step is typically a tenth of a percept's spread, so the
    factor gives all inputs a similar size. On double pole balancing without velocities, the network
    is learnable only with this factor.

    The parameters of a node are V (outputs, (delays + 1) * inputs) row by row, then c. The earlier
    percepts are in the lane's memory, which is zero when a skill begins. They belong to the action:
    all nodes of the action share them, and time counts its executions.

    Attributes:
        delays: Number of changes d; the memory has d * inputs numbers.
    """

    first_step = 2.0
    native_kind = "DELAY"
    plain_module = "cgtorch.export.plain.networks"

    def __init__(self, inputs: int = 7, delays: int = 3, outputs: int = 3):
        super().__init__()
        self.inputs, self.delays, self.outputs = inputs, delays, outputs
        self.percept_size = inputs
        self.num_parameters = outputs * (inputs * (delays + 1) + 1)
        self.message_size, self.memory_size = outputs, inputs * delays

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        message, memory = lanes.message.clone(), lanes.memory.clone()
        x, earlier = lanes.percept[:, : self.inputs], memory[:, : self.memory_size].clone()
        weights, biases = parameters[:, : self.num_parameters].split(
            [self.num_parameters - self.outputs, self.outputs], -1
        )
        message[:, : self.outputs] = light_layer(percept_and_changes(x, earlier), weights, biases)
        memory[:, : self.memory_size] = torch.cat([x, earlier], -1)[:, : self.memory_size]
        has = torch.ones_like(lanes.has_message)
        lanes = replace(lanes, message=message, has_message=has, memory=memory)
        return lanes, lanes.step.new_zeros(len(lanes))


class LinearNN(DelayNN):
    """A linear network of the percept, V x + c, whose output is sent as a message.

    It has the fewest parameters of any network that reacts to every number of a percept, so it is
    tuned in few episodes if it is sufficient.
    """

    native_kind = "DELAY"
    plain_module = "cgtorch.export.plain.networks"

    def __init__(self, inputs: int = 7, outputs: int = 3):
        super().__init__(inputs, 0, outputs)
