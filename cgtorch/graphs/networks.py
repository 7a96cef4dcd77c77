"""The neural-network actions of section VI; a node's parameters are the network's weights."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.numerics import sigmoid


def network_parameters(inputs: int, hidden: int, outputs: int) -> int:
    """Number of weights of a network with one hidden layer: W1, b1, W2, b2."""
    return hidden * (inputs + 1) + outputs * (hidden + 1)


def one_hidden_layer(x: Tensor, weights: Tensor, hidden: int, outputs: int) -> Tensor:
    """One network per row of x (n, inputs): sigmoid hidden layer, linear output (n, outputs).

    `weights` is (n, network_parameters(inputs, hidden, outputs)). Each row contains W1 (hidden,
    inputs), b1, W2 (outputs, hidden), b2, flattened in this order.
    """
    inputs = x.shape[-1]
    w1, b1, w2, b2 = weights.split([hidden * inputs, hidden, outputs * hidden, outputs], dim=-1)
    # Networks this small are bound by memory traffic: a product and a sum beat a batched matmul.
    h = sigmoid((w1.unflatten(-1, (hidden, inputs)) * x[..., None, :]).sum(-1) + b1)
    return (w2.unflatten(-1, (outputs, hidden)) * h[..., None, :]).sum(-1) + b2


class _Network(Action):
    """A network with one hidden layer whose weights are the node's parameters."""

    first_step = 4.0  # strong actions are found soon; docs/decisions/search.md has the others

    def __init__(self, inputs: int, hidden: int, outputs: int):
        super().__init__()
        self.inputs, self.hidden, self.outputs = inputs, hidden, outputs
        self.percept_size = inputs
        self.num_parameters = network_parameters(inputs, hidden, outputs)

    def sees(self, percept: Tensor) -> Tensor:
        """The numbers (n, inputs) of percepts (n, D) that the network reads."""
        return percept[:, : self.inputs]

    def network(self, lanes: Lanes, parameters: Tensor) -> Tensor:
        """(n, outputs), before any output activation."""
        seen = self.sees(lanes.percept)
        return one_hidden_layer(seen, parameters, self.hidden, self.outputs)


class ContinuousNN(_Network):
    """Maps the percept to a motion: 7-3-3, sigmoid hidden layer, linear output, sent as message."""

    native_kind = "CONTINUOUS"
    plain_module = "cgtorch.export.plain.networks"

    def __init__(self, inputs: int = 7, hidden: int = 3, outputs: int = 3):
        super().__init__(inputs, hidden, outputs)
        self.message_size = outputs

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        message = lanes.message.clone()
        message[:, : self.outputs] = self.network(lanes, parameters)
        lanes = replace(lanes, message=message, has_message=torch.ones_like(lanes.has_message))
        return lanes, lanes.step.new_zeros(len(lanes))


class BranchingNN(_Network):
    """Maps the percept to one of two branches: 7-3-2, all sigmoid; the larger output decides."""

    outcomes: tuple[str, ...] = ("out1", "out2")
    native_kind = "BRANCHING"
    plain_module = "cgtorch.export.plain.networks"

    def __init__(self, inputs: int = 7, hidden: int = 3):
        super().__init__(inputs, hidden, outputs=2)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        out = sigmoid(self.network(lanes, parameters))
        return lanes, (out[:, 1] > out[:, 0]).long()
